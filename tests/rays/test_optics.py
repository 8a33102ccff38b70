"""Intrinsics that are drawn: in their ranges, repeatable, K in the sense of conventions.md."""

import numpy as np
import pytest

from jaxcam.errors import ConfigError
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.rays.optics import OpticsRanges, at_size, sample_optics

WIDE = OpticsRanges((35, 55), (1, 1.5), (0, 0.1), "opencv", ((-0.3, 0), (0, 0.1)))


def test_values_are_in_their_ranges_and_fill_them():
    K, lens = sample_optics(WIDE, 2000, 1)
    fovy = np.rad2deg(2 * np.arctan(0.5 / K[:, 1, 1]))
    aspect, offset = K[:, 1, 1] / K[:, 0, 0], np.hypot(K[:, 0, 2] - 0.5, K[:, 1, 2] - 0.5)
    drawn = [fovy, aspect, offset, lens[:, 0], lens[:, 1]]
    for values, (low, high) in zip(drawn, [*[*vars(WIDE).values()][:3], *WIDE.coefficients],
                                   strict=True):  # fmt: skip
        assert low - 1e-9 <= values.min() < low + 0.01 * (high - low)
        assert high - 0.01 * (high - low) < values.max() <= high + 1e-9
        assert np.isclose(values.mean(), (low + high) / 2, atol=0.03 * (high - low))
    assert abs(np.corrcoef(drawn) - np.eye(5)).max() < 0.1
    assert not lens[:, 2:].any()


def test_more_cameras_go_on_and_a_range_moves_no_other_draw():
    few, many = sample_optics(WIDE, 3, 7), sample_optics(WIDE, 9, 7)
    assert all(np.array_equal(a, b[:3]) for a, b in zip(few, many, strict=True))
    assert not np.allclose(few[0], sample_optics(WIDE, 3, 8)[0])
    alone = sample_optics(OpticsRanges((35, 55)), 3, 7)
    assert np.array_equal(alone[0][:, 1, 1], few[0][:, 1, 1])
    assert alone[1] is None


def test_one_value_is_the_usual_k_at_every_size():
    K, _ = sample_optics(OpticsRanges((45, 45)), 2, 0)
    for size in ((84, 84), (96, 128), (128, 96)):
        assert np.allclose(at_size(K, *size), intrinsics(45, *size), rtol=1e-14)
    K = at_size(sample_optics(OpticsRanges((45, 45), (1.5, 1.5)), 1, 0)[0], 84)[0]
    assert np.isclose(42 / K[0, 0], 1.5 * np.tan(np.deg2rad(22.5)))  # half the width it shows


def test_impossible_ranges_are_refused():
    for ranges in (((0, 45),), ((50, 45),), ((45, 180),), ((45, 45), (0, 1))):
        with pytest.raises(ConfigError, match="optics ranges"):
            OpticsRanges(*ranges)
