"""Conditioning: what a policy is told of its cameras, and what it is not."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from policy_inputs import (
    CONDITIONINGS,
    laptop,
    make,
    make_batch,
    make_plain,
    moved,
    shapes,
    start,
    tiny,
)

from jaxcam.errors import ConfigError
from jaxcam.models import ACT_PRESETS
from jaxcam.models.conditioning import NOMINAL_POSE, VisionConfig, with_conditioning
from jaxcam.models.fusion import grid_rays
from jaxcam.rays import plucker


@pytest.mark.parametrize("network", CONDITIONINGS)
def test_image_only_twin_has_the_same_shapes_and_ignores_the_pose(network):
    batch = make_batch()
    full = make(tiny(laptop(network), network, twin_of=network))
    twin = make(tiny(laptop(network), "none", twin_of=network))
    same = jax.tree.map(lambda a, b: a.shape == b.shape, shapes(full), shapes(twin))
    assert jax.tree.all(same)
    params = start(full)
    for policy, listens in ((full, network != "none"), (twin, False)):
        act = policy.act
        here, there = act(params, batch, None), act(params, moved(batch), None)
        assert np.array_equal(here, there) != listens


@pytest.mark.parametrize("network", [way for way in CONDITIONINGS if way != "none"])
def test_twin_is_the_network_at_the_nominal_pose(network):
    batch = make_batch()
    full = make(tiny(laptop(network), network))
    twin = make(tiny(laptop(network), "none", twin_of=network))
    params = start(full)
    nominal = np.tile(np.array(NOMINAL_POSE, np.float32), (2, 1, 1, 1))
    np.testing.assert_array_equal(
        full.act(params, batch | {"base_from_camera": nominal}, None),
        twin.act(params, batch, None),
    )


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


def test_authors_convention_changes_the_rays_of_the_paper_preset():
    batch = make_batch()
    config = tiny("paper", "late")
    assert config.ray_convention == "authors"
    authors, ours = (make(tiny("paper", "late", ray_convention=c)) for c in ("authors", "jaxcam"))
    params = start(authors)
    assert not np.allclose(authors.act(params, batch, None), ours.act(params, batch, None))


def test_image_size_must_suit_the_encoder():
    with pytest.raises(ConfigError, match=r"18x18.*multiples of 4"):
        make(tiny("laptop", "keypoints"), 18)


def test_folding_must_suit_the_cells():
    with pytest.raises(ConfigError, match="fold 3 does not divide the 4x4 cells"):
        make(tiny("attention", "late", fold=3))


def test_the_attention_preset_is_one_network_for_all_ways():
    """Parameters within a tenth of late fusion's, so that encodings are compared at equal size."""
    sizes = {}
    for way in CONDITIONINGS:
        config = with_conditioning(ACT_PRESETS["attention"], way)
        policy = make_plain(replace(config, twin_of="none") if way == "none" else config, 84)
        sizes[way] = sum(np.prod(leaf.shape) for leaf in jax.tree.leaves(shapes(policy)))
    assert sizes.pop("keypoints") < sizes["late"]
    assert all(abs(size / sizes["late"] - 1) < 0.1 for size in sizes.values()), sizes
    assert sizes["prope"] == sizes["gta"] == sizes["ray_rope"] == sizes["warp"] == sizes["none"]
