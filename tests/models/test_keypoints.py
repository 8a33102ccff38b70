"""Key points: the mean of a heat map, the ray through it, and heat maps that are taught."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from policy_inputs import ACTION, CHUNK, jit, make_batch, make_plain, start, tiny

from jaxcam.models.conditioning import NOMINAL_POSE, VisionConfig
from jaxcam.models.fusion import grid_rays
from jaxcam.models.keypoints import (
    KeypointPool,
    heatmap_loss,
    lift_to_height,
    pool_keypoints,
)
from jaxcam.rays import Camera, plucker

SIZE, CELLS = 16, 4


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


def in_sight(views=2, pixel=(5.0, 11.0), batch=3):
    """A batch whose first keyframes lie at a pixel of the first view."""
    made = make_batch(SIZE, views=views, batch=2, seed=4)
    made = {name: np.repeat(values[:1], batch, 0) for name, values in made.items()}
    first = Camera(made["K"][:, 0], made["base_from_camera"][:, 0], SIZE, SIZE)
    at = np.broadcast_to(np.array(pixel), (batch, 1, 2))
    made["keyframe"][:, :1] = first.unproject(np.full((batch, 1), 0.9), at)
    made["is_pad"][:] = False
    return made


def uniform(batch, views=2, maps=3):
    return jnp.zeros((batch * views, CELLS, CELLS, maps))


def best(batch):
    """Heat maps that a loss on them alone leads to, [B*V, h, w, k]."""
    count, views = batch["K"].shape[:2]
    heat = uniform(count, views)
    gradient = jit(jax.grad(lambda heat: heatmap_loss(heat, batch)))
    for _ in range(2000):
        heat = heat - 6 * gradient(heat)
    return heat


@pytest.mark.parametrize("pixel", [(5.0, 11.0), (7.9, 8.1), (2.0, 2.0)])
def test_the_expected_place_under_a_taught_map_is_where_the_keyframe_is_seen(pixel):
    batch = in_sight(pixel=pixel)
    batch["action"][:, 0, -1] = -1
    heat = best(batch)
    rays = jnp.zeros((*heat.shape[:3], 6))
    pooled = pool_keypoints(heat, rays, jnp.zeros((*heat.shape[:3], 1)))
    places = (np.asarray(pooled.pixel).reshape(3, 2, 3, 2) + 1) / 2 * SIZE
    cameras = Camera(batch["K"], batch["base_from_camera"], SIZE, SIZE)
    expected, _ = cameras.project(batch["keyframe"][:, :1])
    np.testing.assert_allclose(expected[:, 0], np.broadcast_to(pixel, (3, 2)), atol=1e-3)
    inside = ((expected > 2) & (expected < SIZE - 2)).all(-1)
    np.testing.assert_allclose(places[:, :, 0][inside], expected[inside], atol=0.15)
    np.testing.assert_array_equal(heat[..., 1:], 0)  # what is not taught stays


def test_the_first_map_is_taught_while_the_gripper_is_open_the_second_while_it_is_closed():
    batch = in_sight()
    batch["action"][:, 0, -1] = [-1, 1, 1]
    gradient = np.asarray(jax.grad(heatmap_loss)(uniform(3), batch)).reshape(3, 2, -1, 3)
    moved = (gradient[:, 0] != 0).any(1)
    assert moved.tolist() == [[True, False, False], [False, True, False], [False, True, False]]


@pytest.mark.parametrize("why", ["behind", "outside", "past the end", "unknown", "lens"])
def test_nothing_is_taught_where_no_keyframe_is_seen(why):
    batch = in_sight(views=1)
    if why == "behind":
        pose = batch["base_from_camera"][:, 0]
        batch["keyframe"][:, 0] = pose[:, :3, 3] - 0.5 * pose[:, :3, 2]
    elif why == "outside":
        batch["K"][..., 0, 2] += 2 * SIZE
    elif why == "past the end":
        batch["is_pad"][:, 0] = True
    elif why == "unknown":
        batch["keyframe_is_pad"] = batch["is_pad"] | (np.arange(CHUNK) == 0)
    else:  # one that shows less than the keyframe is from its middle
        batch["K"][..., 0, 2] -= 7.5
        batch["distortion"] = np.zeros((3, 1, 9), np.float32)
        batch["distortion"][..., 0] = -40
    loss, gradient = jax.value_and_grad(heatmap_loss)(uniform(3, 1), batch)
    assert loss == 0
    np.testing.assert_array_equal(gradient, 0)


def test_the_loss_is_a_mean_over_views_that_see_the_keyframe():
    batch = in_sight()
    whole = heatmap_loss(uniform(3), batch)
    assert whole == pytest.approx(np.log(CELLS**2), rel=1e-5)
    batch["keyframe_is_pad"] = np.zeros((3, CHUNK), bool)
    batch["keyframe_is_pad"][1:] = True
    assert heatmap_loss(uniform(3), batch) == pytest.approx(float(whole), rel=1e-5)


def test_act_adds_it_by_its_weight_and_its_predictions_do_not_change():
    batch = in_sight()
    plain, taught = tiny("laptop", "keypoints"), tiny("laptop", "keypoints", heatmap_weight=0.5)
    policies = [make_plain(config, SIZE, views=2) for config in (plain, taught)]
    params = start(policies[0])
    losses = [jit(policy.loss)(params, batch, None) for policy in policies]
    metrics = losses[1][1]
    assert "heatmap" not in losses[0][1]
    assert losses[1][0] == pytest.approx(float(losses[0][0] + 0.5 * metrics["heatmap"]), rel=1e-5)
    observed = {k: batch[k] for k in ("image", "K", "base_from_camera", "proprio")}
    acts = [policy.act(params, observed, None) for policy in policies]
    np.testing.assert_array_equal(*acts)
    assert acts[0].shape == (3, CHUNK, ACTION)


def test_the_image_only_twin_is_taught_the_same_and_sees_no_pose():
    batch = in_sight()
    twin = make_plain(tiny("laptop", "none", heatmap_weight=0.5), SIZE, views=2)
    params = start(twin)
    moved = {**batch, "base_from_camera": batch["base_from_camera"] + 0.0}
    moved["base_from_camera"][..., 0, 3] += 0.02
    losses = [jit(twin.loss)(params, one, None)[1] for one in (batch, moved)]
    assert losses[0]["l1"] == losses[1]["l1"]
    assert losses[0]["heatmap"] != losses[1]["heatmap"]
