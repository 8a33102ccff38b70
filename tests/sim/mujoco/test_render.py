"""Pictures and depths of both ray tracers against geometry: MuJoCo's rays, planes and faces."""

import mujoco
import numpy as np
import pytest

from jaxcam.rays import Camera, sample_poses, spherical
from jaxcam.rays.rotations import matrix_from_quaternion
from jaxcam.sim.mujoco.render import Renderer
from jaxcam.sim.mujoco.table import TABLE_TOP
from jaxcam.sim.mujoco.tracer.painter import CpuRenderer
from jaxcam.sim.task import starts
from jaxcam.sim.types import View

HEIGHT, WIDTH, COUNT = 30, 36, 6


def make_view(lift, scene, count=COUNT, height=HEIGHT, width=WIDTH, seed=3):
    """Views that differ in everything: state, cube, fixtures, pose, focal lengths, centre."""
    rng = np.random.default_rng(seed)
    start = starts(lift, scene, range(100, 100 + count))
    K = np.zeros((count, 3, 3))
    K[:, 0, 0], K[:, 1, 1] = rng.uniform(0.9, 1.8, (2, count)) * height
    K[:, 0, 2] = width / 2 + rng.uniform(-0.2, 0.2, count) * width
    K[:, 1, 2] = height / 2 + rng.uniform(-0.2, 0.2, count) * height
    K[:, 2, 2] = 1
    poses = sample_poses(lift.cameras, count, 5)
    return View(start.qpos, start.geom_size, start.fixtures, K, poses)


def one(view, i):
    return View(*(x[[i]] for x in view[:5]))


def cast(scene, lift, view, i, camera):
    """Planar depth and geom seen by every pixel, by `mj_ray` along `jaxcam.rays`' directions."""
    model, rays = scene.visual, np.asarray(camera.plucker(), float)
    data = mujoco.MjData(model)
    ids = [model.geom(f"{name}_vis").id for name in lift.varied]
    before = model.geom_size[ids].copy(), model.geom_rbound[ids].copy(), model.geom_aabb[ids].copy()
    model.geom_size[ids] = view.geom_size[i]
    model.geom_rbound[ids] = np.linalg.norm(view.geom_size[i], axis=-1)
    model.geom_aabb[ids, 3:] = view.geom_size[i]
    data.qpos = view.qpos[i]
    data.mocap_pos[scene.fixtures] = view.fixtures[i, :, :3]
    data.mocap_quat[scene.fixtures] = view.fixtures[i, :, 3:]
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    pose = np.asarray(camera.world_from_camera)
    pixels = rays[..., :3].reshape(-1, 3).copy()
    geoms, distance = np.empty(len(pixels), np.int32), np.empty(len(pixels))
    groups = np.array([0, 1, 0, 0, 0, 0], np.uint8)
    for k, direction in enumerate(pixels):
        hit = np.array([-1], np.int32)
        distance[k] = mujoco.mj_ray(model, data, pose[:3, 3], direction, groups, 1, -1, hit)
        geoms[k] = hit[0]
    model.geom_size[ids], model.geom_rbound[ids], model.geom_aabb[ids] = before
    depth = np.where(geoms < 0, np.inf, distance * (pixels @ pose[:3, 2]))
    return depth.reshape(rays.shape[:2]), geoms.reshape(rays.shape[:2])


def on_box(points, pose, half):
    """Signed distance (m) of points to the faces of a box at a pose (xyz, wxyz)."""
    local = (points - pose[:3]) @ matrix_from_quaternion(pose[3:])
    return (abs(local) - half).max(-1)


@pytest.fixture(scope="module", params=[Renderer, CpuRenderer])
def kind(request):
    return request.param


@pytest.fixture(scope="module", params=["randomized", "fixed"])
def drawn(request, kind, lift, scenes):
    scene = scenes[request.param]
    renderer = kind(scene, HEIGHT, WIDTH, varied=lift.varied, batch=4)
    view = make_view(lift, scene)
    if request.param == "fixed":  # the table may be moved there too
        view.fixtures[:, 0, :2] = np.random.default_rng(0).uniform(-0.2, 0.2, (COUNT, 2))
    return scene, renderer, view, *renderer.rgb_and_depth(view)


def test_depth_unprojected_with_our_rays_lands_on_the_geometry(lift, drawn):
    scene, _, view, _, depth = drawn
    table, cube = scene.visual.geom("table_visual").id, scene.visual.geom("cube_g0_vis").id
    on_table = on_cube = 0
    for i in range(COUNT):
        camera = Camera(view.K[i], view.world_from_camera[i], HEIGHT, WIDTH).validate()
        expected, geom = cast(scene, lift, view, i, camera)
        # The tracer takes float32 and edges may fall on either side, so: nearly all pixels agree.
        agree = np.isclose(depth[i], expected, rtol=0, atol=1e-4)
        assert agree.mean() > 0.995, i
        drawn = np.isfinite(depth[i]) & agree
        points = np.asarray(camera.unproject(np.where(drawn, depth[i], 1.0)))
        slab = points[drawn & (geom == table)]
        faces = on_box(slab, view.fixtures[i, 0], scene.visual.geom("table_visual").size)
        np.testing.assert_allclose(faces, 0, atol=1e-4)
        on_table += (abs(slab[:, 2] - TABLE_TOP) < 1e-4).sum()
        at = scene.qpos_of("cube")
        block = points[drawn & (geom == cube)]
        faces = on_box(block, view.qpos[i, at : at + 7], view.geom_size[i, 0])
        np.testing.assert_allclose(faces, 0, atol=1e-4)
        on_cube += len(block)
    assert on_table > 100 * COUNT
    assert on_cube > 3 * COUNT


def test_a_view_alone_equals_the_same_view_in_a_batch(drawn):
    _, renderer, view, rgb, depth = drawn
    assert len({picture.tobytes() for picture in rgb}) == COUNT
    for i in (0, 5):  # 6 views in batches of 4: view 5 is in the padded one
        picture, planar = renderer.rgb_and_depth(one(view, i))
        np.testing.assert_array_equal(picture[0], rgb[i])
        np.testing.assert_array_equal(planar[0], depth[i])


def test_batch_width_changes_nothing(kind, lift, drawn):
    scene, _, view, rgb, _ = drawn
    other = kind(scene, HEIGHT, WIDTH, varied=lift.varied, batch=1)
    np.testing.assert_array_equal(other.rgb(view), rgb)


def test_pictures_are_bytes_and_not_blown_out(drawn):
    _, _, _, rgb, _ = drawn
    assert rgb.dtype == np.uint8
    assert rgb.shape == (COUNT, HEIGHT, WIDTH, 3)
    assert (rgb == 255).mean() < 0.005
    assert 60 < rgb.mean() < 200
    assert (rgb.reshape(COUNT, -1).std(1) > 10).all()


def test_the_green_cube_is_where_the_camera_projects_it(kind, lift, scene):
    size = 64
    renderer = kind(scene, size, varied=lift.varied, batch=4)
    view = make_view(lift, scene, 12, size, size, seed=8)
    rgb = renderer.rgb(view).astype(int)
    checked = 0
    for i in range(12):
        camera = Camera(view.K[i], view.world_from_camera[i], size, size)
        cube = view.qpos[i, scene.qpos_of("cube") :][:3]
        pixel, _ = camera.project(cube)
        green = rgb[i, ..., 1] - rgb[i, ..., [0, 2]].max(0) > 25
        if green.sum() < 8:  # hidden or outside of this view
            continue
        row, column = np.argwhere(green).mean(0) + 0.5
        assert np.hypot(column - pixel[0], row - pixel[1]) < 3
        checked += 1
    assert checked >= 6


def test_up_in_the_world_is_up_in_the_picture(kind, lift, scene):
    """The sky, above the horizon, fills the first rows of a level camera's picture."""
    start = starts(lift, scene, [0])
    pose = sample_poses(lift.cameras, 1, 0)
    _, _, distance = spherical(pose, np.array(lift.cameras.centre))
    assert distance < 2
    # x right, y down, z forward in the world: looking along -x, from above the table.
    level = np.eye(4)
    level[:3, :3] = np.array([[0, 1, 0], [0, 0, -1], [-1, 0, 0]]).T
    level[:3, 3] = 1.2, 0.9, 1.1
    renderer = kind(scene, HEIGHT, WIDTH, varied=lift.varied, batch=1)
    K = np.array([[[30.0, 0, WIDTH / 2], [0, 30, HEIGHT / 2], [0, 0, 1]]])
    rgb, depth = renderer.rgb_and_depth(View(*start, K, level[None]))
    assert np.isinf(depth[0, 0]).all()
    assert np.isfinite(depth[0, -1]).all()
    assert (rgb[0, 0] == rgb[0, 0, 0]).all()


def test_supersampling_smooths_and_keeps_the_picture(kind, lift, scene):
    view = make_view(lift, scene, 2)
    plain, smooth = (
        kind(scene, HEIGHT, WIDTH, varied=lift.varied, batch=2, samples=n).rgb(view) for n in (1, 2)
    )
    assert smooth.shape == plain.shape
    assert abs(plain.astype(int) - smooth).mean() < 6
    assert kind.look(samples=2) != kind.look()
