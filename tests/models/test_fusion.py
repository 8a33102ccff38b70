"""Conditioning: what a policy is told of its cameras, and what it is not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from policy_inputs import CONDITIONINGS, make, make_batch, moved, shapes, start, tiny

from jaxcam.errors import ConfigError
from jaxcam.models.conditioning import NOMINAL_POSE, VisionConfig
from jaxcam.models.fusion import grid_rays
from jaxcam.models.keypoints import lift_to_height, pool_keypoints
from jaxcam.rays import plucker


@pytest.mark.parametrize("network", CONDITIONINGS)
def test_image_only_twin_has_the_same_shapes_and_ignores_the_pose(network):
    batch = make_batch()
    full = make(tiny("laptop", network, twin_of=network))
    twin = make(tiny("laptop", "none", twin_of=network))
    same = jax.tree.map(lambda a, b: a.shape == b.shape, shapes(full), shapes(twin))
    assert jax.tree.all(same)
    params = start(full)
    for policy, listens in ((full, network != "none"), (twin, False)):
        act = policy.act
        here, there = act(params, batch, None), act(params, moved(batch), None)
        assert np.array_equal(here, there) != listens


@pytest.mark.parametrize("network", ["token", "early", "late", "keypoints"])
def test_twin_is_the_network_at_the_nominal_pose(network):
    batch = make_batch()
    full = make(tiny("laptop", network))
    twin = make(tiny("laptop", "none", twin_of=network))
    params = start(full)
    nominal = np.tile(np.array(NOMINAL_POSE, np.float32), (2, 1, 1, 1))
    np.testing.assert_array_equal(
        full.act(params, batch | {"base_from_camera": nominal}, None),
        twin.act(params, batch, None),
    )


def test_nominal_pose_is_a_camera_that_looks_at_the_table():
    pose = np.array(NOMINAL_POSE)
    np.testing.assert_allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=1e-12)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)
    # The table's centre, in the base frame, lies 0.95 m ahead in the middle of the image.
    centre = np.linalg.inv(pose) @ [0.56, 0.0, 0.8 - 0.912, 1.0]
    np.testing.assert_allclose(centre, [0, 0, 0.95, 1], atol=1e-12)


def test_intrinsics_reach_the_twin():
    batch = make_batch()
    policy = make(tiny("laptop", "none"))
    params = start(policy)
    zoomed = batch | {"K": batch["K"] * np.array([[1.2], [1.2], [1]], np.float32)}
    assert not np.allclose(policy.act(params, batch, None), policy.act(params, zoomed, None))


def test_grid_rays_are_those_of_the_cells():
    config, batch = VisionConfig(conditioning="keypoints"), make_batch(views=2)
    coarse = grid_rays(config, batch, 4, 4).reshape(2, 2, 4, 4, 6)
    fine = plucker(batch["K"], batch["base_from_camera"], 16, 16)
    # A cell's centre is the corner its four middle pixels share; lines add up to a line.
    middle = sum(fine[:, :, i::4, j::4] for i in (1, 2) for j in (1, 2))
    middle = middle / np.linalg.norm(middle[..., :3], axis=-1, keepdims=True)
    np.testing.assert_allclose(coarse, middle, atol=2e-3)


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


def test_authors_convention_changes_the_rays_of_the_paper_preset():
    batch = make_batch()
    config = tiny("paper", "late")
    assert config.ray_convention == "authors"
    authors, ours = (make(tiny("paper", "late", ray_convention=c)) for c in ("authors", "jaxcam"))
    params = start(authors)
    assert not np.allclose(authors.act(params, batch, None), ours.act(params, batch, None))


@pytest.mark.parametrize(
    ("changes", "hint"),
    [
        ({"conditioning": "keypoint"}, "keypoints"),
        ({"twin_of": "lat"}, "late"),
        ({"encoder": "resnet"}, "resnet18"),
        ({"compute_dtype": "bf16"}, "bfloat16"),
    ],
)
def test_unknown_names_are_refused_with_the_nearest(changes, hint):
    with pytest.raises(ConfigError, match=f"did you mean '{hint}'"):
        VisionConfig(**changes)


def test_image_size_must_suit_the_encoder():
    with pytest.raises(ConfigError, match=r"18x18.*multiples of 4"):
        make(tiny("laptop", "keypoints"), 18)
