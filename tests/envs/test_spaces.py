"""Bounds of actions: what demonstrations do is within them, in the units of the space."""

import numpy as np
import pytest

from jaxcam.data.batches import demo_actions
from jaxcam.envs.spaces import actions, observations
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.sim.actions import ACTION_SPACES


@pytest.mark.parametrize("space", [*ACTION_SPACES, "eef_delta_componentwise", "eef_abs_world"])
def test_demonstrations_are_within(demos, scene, space):
    box = actions(space, scene, None)
    for demo in demos.episodes:
        for action in demo_actions(demo, space, scene):
            assert action.astype(np.float32) in box


def test_a_chunk_is_so_many_actions(scene):
    one, chunk = actions("eef_abs", scene, None), actions("eef_abs", scene, 4)
    assert chunk.shape == (4, 7)
    np.testing.assert_array_equal(chunk.low, np.tile(one.low, (4, 1)))
    assert one.low[0] < scene.world_from_base[0, 3] < one.high[0]


def test_observations_are_those_of_the_contract():
    space = observations(intrinsics(45, 20, 30), 2, 20, 30)
    assert {name: (box.shape, str(box.dtype)) for name, box in space.items()} == {
        "image": ((2, 20, 30, 3), "uint8"),
        "K": ((2, 3, 3), "float32"),
        "base_from_camera": ((2, 4, 4), "float32"),
        "state": ((11,), "float32"),
    }
    assert all(np.isfinite([box.low.max(), box.high.max()]).all() for box in space.values())
