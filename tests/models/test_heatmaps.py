"""Heat maps that are taught lie where keyframes are seen, and are taught nothing else."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from policy_inputs import ACTION, CHUNK, jit, make_batch, make_plain, start, tiny

from jaxcam.models.heatmaps import heatmap_loss
from jaxcam.models.keypoints import pool_keypoints
from jaxcam.rays import Camera

SIZE, CELLS = 16, 4


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
