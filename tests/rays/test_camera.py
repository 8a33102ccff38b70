"""The camera record: projection, image operations that keep K right, and its life as a pytree."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rays_oracle import random_camera, random_poses, seeds

from jaxcam.errors import CameraError
from jaxcam.rays import Camera, invert, look_at

H, W = 6, 9
some = settings(max_examples=25, deadline=None, derandomize=True)


@some
@given(seeds)
def test_project_follows_the_pinhole_equation(seed):
    camera = random_camera(seed)
    rng = np.random.default_rng(seed)
    points_C = rng.uniform((-1, -1, 1.5), (1, 1, 3.5), (5, 3))
    X = camera.world_from_camera
    uv, depth = camera.project(points_C @ X[:3, :3].T + X[:3, 3])
    homogeneous = points_C @ camera.K.T
    np.testing.assert_allclose(depth, points_C[:, 2], atol=1e-12)
    np.testing.assert_allclose(uv, homogeneous[:, :2] / homogeneous[:, 2:], atol=1e-9)


@some
@given(seeds)
def test_unproject_undoes_project(seed):
    camera = random_camera(seed, batch=(2,))
    depth = np.random.default_rng(seed).uniform(0.2, 4, (2, H, W))
    uv, z = camera.project(camera.unproject(depth))
    np.testing.assert_allclose(z, depth, atol=1e-9)
    np.testing.assert_allclose(uv, np.broadcast_to(camera.pixel_centres(), uv.shape), atol=1e-6)


def test_unproject_of_given_pixels_is_that_of_the_full_map():
    camera = random_camera(7)
    depth = np.full((H, W), 1.5)
    whole = camera.unproject(depth)
    np.testing.assert_allclose(camera.unproject(np.array(1.5), np.array([2.5, 3.5])), whole[3, 2])


def test_points_of_a_batch_of_cameras():
    camera = random_camera(1, batch=(2, 3))
    points = np.random.default_rng(1).normal(size=(2, 3, 4, 5, 3))
    uv, depth = camera.project(points)
    assert uv.shape == (2, 3, 4, 5, 2)
    single = Camera(camera.K[1, 2], camera.world_from_camera[1, 2], H, W)
    np.testing.assert_allclose(uv[1, 2], single.project(points[1, 2])[0])
    np.testing.assert_allclose(depth[1, 2], single.project(points[1, 2])[1])
    with pytest.raises(CameraError, match=r"batch axes \(2, 3\)"):
        camera.project(np.zeros(3))


def test_depth_of_another_size_is_refused():
    with pytest.raises(CameraError, match=r"\[3, 3\], expected \[..., 6, 9\]"):
        random_camera(0).unproject(np.ones((3, 3)))


@some
@given(seeds, st.integers(0, 3), st.integers(0, 4))
def test_rays_of_the_crop_are_the_crop_of_the_rays(seed, top, left):
    camera = random_camera(seed)
    cropped = camera.crop(top, left, 3, 5)
    assert (cropped.height, cropped.width) == (3, 5)
    want = camera.plucker()[top : top + 3, left : left + 5]
    np.testing.assert_allclose(cropped.plucker(), want, atol=4e-6)


def test_crops_may_differ_within_a_batch_and_be_traced():
    camera = random_camera(2, batch=(2,))
    top, left = np.array([0, 3]), np.array([4, 1])
    want = np.stack(
        [camera.plucker()[i, top[i] : top[i] + 3, left[i] : left[i] + 5] for i in range(2)]
    )
    np.testing.assert_allclose(camera.crop(top, left, 3, 5).plucker(), want, atol=4e-6)
    traced = jax.jit(lambda c, t, x: c.crop(t, x, 3, 5).plucker())(camera, top, left)
    np.testing.assert_allclose(traced, want, atol=4e-6)
    shared = Camera(camera.K[0], camera.world_from_camera, H, W).crop(top, left, 3, 5)
    assert shared.plucker().shape == (2, 3, 5, 6)


@some
@given(seeds)
def test_resize_keeps_the_rays_of_coinciding_pixel_centres(seed):
    camera = random_camera(seed)
    big = camera.resize(3 * H, 5 * W)
    np.testing.assert_allclose(big.plucker()[1::3, 2::5], camera.plucker(), atol=2e-6)
    back = big.resize(H, W)
    np.testing.assert_allclose(back.K, camera.K, rtol=1e-6, atol=1e-9)


@some
@given(seeds)
def test_rays_of_the_flip_are_the_flip_of_the_rays(seed):
    camera = random_camera(seed)
    flipped = camera.flip_horizontal().validate()
    np.testing.assert_allclose(flipped.plucker(), camera.plucker()[:, ::-1], atol=2e-6)
    np.testing.assert_allclose(flipped.flip_horizontal().K, camera.K, atol=1e-9)
    np.testing.assert_array_equal(flipped.world_from_camera, camera.world_from_camera)


@some
@given(seeds)
def test_image_operations_commute_with_projection(seed):
    camera = random_camera(seed)
    point = camera.unproject(np.array(2.0), np.array([3.2, 4.1]))
    uv = {
        "crop": camera.crop(1, 2, 4, 5).project(point)[0],
        "resize": camera.resize(12, 27).project(point)[0],
        "flip": camera.flip_horizontal().project(point)[0],
    }
    np.testing.assert_allclose(uv["crop"], [1.2, 3.1], atol=1e-6)
    np.testing.assert_allclose(uv["resize"], [9.6, 8.2], atol=1e-6)
    np.testing.assert_allclose(uv["flip"], [W - 3.2, 4.1], atol=1e-6)


@some
@given(seeds)
def test_change_of_frame_moves_the_points_with_it(seed):
    camera = random_camera(seed)
    base_from_world = random_poses(np.random.default_rng(seed + 1))
    p_W = np.array([0.3, -0.2, 0.5])
    p_B = base_from_world[:3, :3] @ p_W + base_from_world[:3, 3]
    here, there = camera.project(p_W), camera.in_frame(base_from_world).project(p_B)
    np.testing.assert_allclose(there[1], here[1], atol=1e-9)
    np.testing.assert_allclose(there[0], here[0], rtol=1e-6)
    back = camera.in_frame(base_from_world).in_frame(invert(base_from_world))
    np.testing.assert_allclose(back.world_from_camera, camera.world_from_camera, atol=1e-12)


def test_from_fovy_sees_that_angle():
    camera = Camera.from_fovy(np.deg2rad(45.0), 256, 320)
    np.testing.assert_allclose(camera.K[0, 0], 309.01934, rtol=1e-7)
    np.testing.assert_allclose(camera.K[:2, 2], [160, 128])
    np.testing.assert_allclose(camera.fovy, np.deg2rad(45.0))
    top_edge, _ = camera.project(np.array([0, -np.tan(np.deg2rad(22.5)), 1.0]))
    np.testing.assert_allclose(top_edge, [160, 0], atol=1e-9)
    batch = Camera.from_fovy(jnp.array([0.5, 1.0]), 8, 8)
    assert batch.batch == (2,)
    assert isinstance(batch.K, jax.Array)


@pytest.mark.parametrize("fovy", [45.0, 0.0, -0.3, np.nan])
def test_from_fovy_refuses_degrees(fovy):
    with pytest.raises(CameraError, match=r"between 0 and pi radians.*degrees"):
        Camera.from_fovy(fovy, 64, 64)


def test_pytree_with_static_size():
    camera = random_camera(0, batch=(3,))
    leaves, treedef = jax.tree.flatten(camera)
    assert len(leaves) == 2
    assert treedef != jax.tree.structure(camera.crop(0, 0, 3, 3))
    doubled = jax.tree.map(lambda a: 2 * a, camera)
    assert isinstance(doubled, Camera)
    assert doubled.height == H
    mapped = jax.vmap(lambda c: c.plucker())(camera)
    np.testing.assert_allclose(mapped, camera.plucker(), atol=1e-6)


def test_numpy_stays_numpy_with_its_precision():
    camera = random_camera(0)
    changed = camera.crop(1, 1, 4, 4).resize(8, 8).flip_horizontal().in_frame(np.eye(4))
    for leaf in (changed.K, changed.world_from_camera, changed.unproject(np.ones((8, 8)))):
        assert isinstance(leaf, np.ndarray)
        assert leaf.dtype == np.float64


def test_look_at_puts_the_target_in_the_middle_and_up_at_the_top():
    camera = Camera.from_fovy(0.8, 100, 120, look_at(np.array([1, 1, 1.5]), np.array([0, 0, 0.8])))
    uv, depth = camera.project(np.array([0, 0, 0.8]))
    np.testing.assert_allclose(uv, [60, 50], atol=1e-9)
    np.testing.assert_allclose(depth, np.sqrt(1 + 1 + 0.49))
    higher, _ = camera.project(np.array([0, 0, 0.9]))
    assert higher[1] < 50
    np.testing.assert_allclose(higher[0], 60, atol=1e-9)
    camera.validate()
    with pytest.raises(CameraError, match="straight above"):
        look_at(np.array([0, 0, 1.0]), np.zeros(3))
