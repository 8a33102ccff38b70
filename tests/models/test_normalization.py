"""What numbers are scaled by: there and back, and where data do not vary."""

import numpy as np
import pytest

from jaxcam.errors import ConfigError
from jaxcam.models.normalization import (
    RANGE_FLOOR,
    STD_FLOOR,
    action_deviation,
    action_range,
    keyframe_deviation,
    proprio_deviation,
    proprio_range,
)

# The last dimension stands still.
DATA = np.array([[-1.0, 0.02, 3.0], [3.0, 0.05, 3.0], [1.0, 0.02, 3.0]])
STATS = {
    f"{name}_{kind}": function(DATA, axis=0).astype(np.float32)
    for name in ("action", "proprio", "keyframe")
    for kind, function in (("mean", np.mean), ("std", np.std), ("min", np.min), ("max", np.max))
}


@pytest.mark.parametrize("make", [action_deviation, action_range, proprio_deviation, proprio_range])
def test_there_and_back(make):
    scale = make(STATS)
    assert scale.middle.dtype == scale.size.dtype == np.float32
    raw = np.float32([0.3, -0.1, 3.0])
    np.testing.assert_allclose(scale.raw(scale.normalised(raw)), raw, rtol=1e-6)


def test_deviations_standardise_and_ranges_fill_the_unit_interval():
    z = action_deviation(STATS).normalised(DATA)[:, :2]
    np.testing.assert_allclose([z.mean(0), z.std(0)], [[0, 0], [1, 1]], atol=1e-5)
    unit = action_range(STATS).normalised(DATA)[:, :2]
    np.testing.assert_allclose([unit.min(0), unit.max(0)], [[-1, -1], [1, 1]], rtol=1e-5)


def test_actions_that_stand_still_are_divided_by_a_small_floor():
    assert action_deviation(STATS).size[2] == np.float32(STD_FLOOR)
    assert action_deviation(STATS, 0.01).size[2] == np.float32(0.01)
    assert action_range(STATS).size[2] == np.float32(RANGE_FLOOR)


@pytest.mark.parametrize("make", [proprio_deviation, proprio_range])
def test_proprioception_that_stands_still_is_not_blown_up(make):
    scale = make(STATS)
    assert scale.size[2] == 1
    np.testing.assert_allclose(scale.normalised(np.float32([1, 0.03, 3.2]))[2], 0.2, rtol=1e-5)
    assert (scale.size[:2] < 2.1).all()


def test_keyframes_are_standardised_by_what_is_stored():
    scale = keyframe_deviation(STATS | {"keyframe_std": np.float32([2, 3, STD_FLOOR])})
    np.testing.assert_array_equal(scale.size, np.float32([2, 3, STD_FLOOR]))
    np.testing.assert_array_equal(scale.middle, STATS["keyframe_mean"])


@pytest.mark.parametrize("value", [None, "x", [[0.0]], [0.0, float("nan"), 1.0], ["a"]])
def test_statistics_that_are_none_are_refused(value):
    """Those of a checkpoint that somebody edited are not."""
    stats = {k: v for k, v in STATS.items() if k != "action_max"}
    if value is not None:
        stats["action_max"] = np.array(value)
    with pytest.raises(ConfigError, match="Statistics: action_max is"):
        action_range(stats)
