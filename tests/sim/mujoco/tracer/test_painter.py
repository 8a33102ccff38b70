"""The CPU's pictures are those of MJX's ray tracer, in every task, and are drawn alike by all."""

import mujoco
import numpy as np
import pytest

from jaxcam.rays import sample_poses
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.sim import make_task, painter_of
from jaxcam.sim.mujoco.render import Renderer
from jaxcam.sim.mujoco.tracer import painter as painter_module
from jaxcam.sim.mujoco.tracer.painter import CpuRenderer
from jaxcam.sim.task import starts
from jaxcam.sim.types import View

PIXELS, COUNT = 84, 8
TASKS = ("lift", "pick_place_can", "square")


def views(task, scene, seed, count=COUNT):
    """Starts, with the arm moved at random, as many random cameras see them."""
    rng = np.random.default_rng(seed)
    start = starts(task, scene, range(100 * seed, 100 * seed + count))
    qpos = start.qpos.copy()
    qpos[:, scene.arm] += rng.uniform(-0.3, 0.3, (count, 7))
    K = np.tile(intrinsics(task.fovy_deg, PIXELS), (count, 1, 1))
    K[:, :2, 2] += rng.uniform(-8, 8, (count, 2))
    poses = sample_poses(task.cameras, count, seed)
    return View(qpos, start.geom_size, start.fixtures, K, poses)


def both(task, scene, view, **options):
    """Pictures and depths by both."""
    return [
        kind(scene, PIXELS, varied=task.varied, batch=COUNT, **options).rgb_and_depth(view)
        for kind in (Renderer, CpuRenderer)
    ]


@pytest.mark.parametrize("name", TASKS)
@pytest.mark.parametrize("scene_name", ["randomized", "fixed"])
def test_pictures_are_those_of_mjx(name, scene_name):
    task = make_task(name)
    scene = task.scene(scene_name)
    (theirs, their_depth), (ours, our_depth) = both(task, scene, views(task, scene, 5))
    apart = abs(theirs.astype(int) - ours).max(-1)
    # A level of 255 where a sum is rounded otherwise; more only at edges, hardly anywhere.
    assert abs(theirs.astype(int) - ours).mean() < 0.01
    assert (apart > 0).mean() < 0.01
    assert (apart > 1).mean() < 1e-4
    assert np.isclose(their_depth, our_depth, rtol=0, atol=1e-4).mean() > 0.9995
    assert theirs.reshape(COUNT, -1).std(1).min() > 10  # there is something to be seen


def test_without_shadows_too_and_they_matter(lift, scene):
    view = views(lift, scene, 7)
    theirs, ours = (pictures for pictures, _ in both(lift, scene, view, shadows=False))
    assert (abs(theirs.astype(int) - ours).max(-1) > 1).mean() < 3e-4
    lit = CpuRenderer(scene, PIXELS, varied=lift.varied).rgb(view)
    assert (abs(lit.astype(int) - ours).max(-1) > 20).mean() > 0.01
    assert CpuRenderer.look(shadows=False) != CpuRenderer.look()


def test_a_camera_inside_and_beside_of_things_sees_what_mjx_does(lift, scene):
    """Cameras near the gripper: solids reach behind them, and fill the picture."""
    view = views(lift, scene, 9)
    poses = view.world_from_camera.copy()
    poses[:, :3, 3] = [-0.05, 0.0, 1.05]
    poses[:, :3, 3] += np.random.default_rng(1).uniform(-0.15, 0.15, (COUNT, 3))
    (theirs, _), (ours, _) = both(lift, scene, view._replace(world_from_camera=poses))
    assert (abs(theirs.astype(int) - ours).max(-1) > 1).mean() < 1e-3


def test_any_number_of_threads_draws_the_same(lift, scene, monkeypatch):
    view = views(lift, scene, 3, count=5)
    draw = CpuRenderer(scene, PIXELS, varied=lift.varied).rgb
    many = draw(view)
    monkeypatch.setattr(painter_module, "_cores", lambda: 1)
    np.testing.assert_array_equal(draw(view), many)
    assert draw(View(*(x[:0] for x in view[:5]))).shape == (0, PIXELS, PIXELS, 3)


def test_what_it_does_not_know_is_left_to_mjx(scene):
    assert painter_of(scene) is CpuRenderer
    assert painter_of(scene, "mjx-warp") is Renderer
    assert painter_of(scene, "native") is CpuRenderer
    ball = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom type='sphere' size='.1'/></worldbody></mujoco>"
    )
    assert not CpuRenderer.draws(type(scene)(**{**vars(scene), "visual": ball}))


def test_looks_tell_the_two_apart():
    assert CpuRenderer.look() != Renderer.look()
