"""Key points: the mean of a heat map, and the ray through it."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from policy_inputs import make_batch

from jaxcam.models.conditioning import NOMINAL_POSE, VisionConfig
from jaxcam.models.fusion import grid_rays
from jaxcam.models.keypoints import KeypointPool, lift_to_height, pool_keypoints
from jaxcam.rays import plucker


def test_one_hot_heat_map_returns_that_pixel_and_its_ray():
    batch = make_batch(12)
    rays = grid_rays(VisionConfig(conditioning="keypoints"), batch, 12, 12)
    row, column = 3, 8
    logits = jnp.zeros((2, 12, 12, 1)).at[:, row, column].set(1e3)
    features = jnp.asarray(np.random.default_rng(0).normal(size=(2, 12, 12, 5)), jnp.float32)
    points = pool_keypoints(logits, rays, features)
    expected = plucker(batch["K"], batch["base_from_camera"], 12, 12)[:, 0, row, column]
    np.testing.assert_allclose(points.ray[:, 0], expected, rtol=1e-6)
    centre = [(column + 0.5) / 6 - 1, (row + 0.5) / 6 - 1]
    np.testing.assert_allclose(points.pixel[:, 0], [centre] * 2, rtol=1e-6)
    np.testing.assert_allclose(points.features[:, 0], features[:, row, column], rtol=1e-6)


@pytest.mark.parametrize(("corners", "place"), [(False, (0.5, -0.25)), (True, (0.6, -1 / 3))])
def test_positions_are_shares_of_an_oblong_picture(corners, place):
    logits = jnp.zeros((1, 4, 6, 1)).at[:, 1, 4].set(1e3)
    points = pool_keypoints(logits, jnp.ones((1, 4, 6, 6)), jnp.ones((1, 4, 6, 2)), corners=corners)
    np.testing.assert_allclose(points.pixel[0, 0], place, rtol=1e-6)


def test_expected_ray_of_any_heat_map_passes_through_the_camera():
    batch = make_batch(12)
    rays = grid_rays(VisionConfig(conditioning="keypoints"), batch, 12, 12)
    logits = jax.random.normal(jax.random.key(0), (2, 12, 12, 4)) * 3
    ray = np.asarray(pool_keypoints(logits, rays, rays).ray)
    centre = batch["base_from_camera"][:, 0, None, :3, 3]
    np.testing.assert_allclose(ray[..., 3:], np.cross(centre, ray[..., :3]), atol=1e-6)


def make_lines(rng, count):
    d = rng.normal(size=(count, 3))
    d[:, 2] = -np.abs(d[:, 2]) - 0.3
    p = rng.normal(size=(count, 3))
    return jnp.asarray(np.concatenate([d, np.cross(p, d)], -1), jnp.float32)


def test_lifted_point_lies_on_its_line_at_its_height():
    rng = np.random.default_rng(1)
    ray = make_lines(rng, 50)
    height = jnp.asarray(rng.normal(size=50), jnp.float32)
    point = lift_to_height(ray, height)
    np.testing.assert_allclose(point[:, 2], height, atol=2e-5)
    np.testing.assert_allclose(jnp.cross(point, ray[:, :3]), ray[:, 3:], atol=2e-4)


@pytest.mark.parametrize("slope", [0.0, 1e-4, -1e-4, 0.05])
def test_lifting_a_flat_line_stays_near_and_differentiable(slope):
    d = np.array([1.0, 0.5, slope])
    ray = jnp.asarray(np.concatenate([d, np.cross([0.2, 0.1, 1.0], d)]), jnp.float32)
    point = lift_to_height(ray, jnp.float32(-0.5))
    np.testing.assert_allclose(jnp.cross(point, ray[:3]), ray[3:], atol=1e-4)
    assert np.linalg.norm(point) < 20
    jacobian = jax.jacobian(lift_to_height)(ray, jnp.float32(-0.5))
    assert np.isfinite(jacobian).all()


def test_lifted_points_are_told_in_a_unit_about_the_table():
    features = jnp.asarray(np.random.default_rng(2).normal(size=(2, 6, 6, 8)), jnp.float32)
    batch = make_batch(6)
    config = VisionConfig(conditioning="keypoints", encoder_width=8, keypoints=3)
    rays = grid_rays(config, batch, 6, 6)
    plain, scaled = (
        np.asarray(
            KeypointPool(replace(config, lift_unit=unit), rngs=nnx.Rngs(0))(features, rays)[0]
        )
        for unit in (0.0, 0.125)
    )
    np.testing.assert_array_equal(scaled[..., :8], plain[..., :8])  # pixels and rays
    middle = NOMINAL_POSE[0][3] - 0.95 * 0.5**0.5, 0, 0.8 - 0.912  # what the nominal camera sees
    np.testing.assert_allclose(scaled[..., 8:] * 0.125 + middle, plain[..., 8:], atol=1e-6)
