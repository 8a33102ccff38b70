"""Edges along normals, and what is behind the arm."""

import cv2
import numpy as np
import pytest

from jaxcam.robot.calibration.arm.edges import behind_arm, find_edges


def step_picture(at: float, blur: float = 1.0) -> np.ndarray:
    """Bright to the left of a column, dark to its right, less a background of nothing."""
    wide = np.where(np.arange(80 * 16) < at * 16, 120.0, 0.0)
    row = wide.reshape(80, 16).mean(1)
    picture = np.tile(row, (40, 1)).astype(np.float32)
    return np.repeat(cv2.GaussianBlur(picture, (0, 0), blur)[..., None], 3, 2)


@pytest.mark.parametrize("at", [40.0, 42.3, 37.75])
@pytest.mark.parametrize("blur", [0.6, 2.0])
def test_an_edge_is_found_to_a_fifth_of_a_pixel(at, blur):
    rng = np.random.default_rng(0)
    picture = step_picture(at, blur) + rng.normal(0, 2, (40, 80, 3)).astype(np.float32)
    pixels = np.stack([np.full(20, 40.0), np.linspace(10, 30, 20)], -1)
    normals = np.tile([1.0, 0], (20, 1))
    got = find_edges(picture, pixels, normals, 6.0)
    assert got.clear.all()
    assert abs(np.median(got.offsets) - (at - 40)) < 0.2
    assert got.contrast.min() > 60


def test_the_middle_of_what_is_blurred_counts_and_not_its_largest_step():
    row = np.zeros(80, np.float32)
    row[:39], row[39], row[40] = 120, 75, 45
    picture = np.repeat(np.tile(row, (40, 1))[..., None], 3, 2)
    got = find_edges(picture, np.array([[40.0, 20]]), np.array([[1.0, 0]]), 6.0)
    assert got.clear.all()
    assert abs(got.offsets[0]) < 0.3


def test_no_contour_has_no_edges():
    got = find_edges(step_picture(40), np.zeros((0, 2)), np.zeros((0, 2)), 6.0)
    assert len(got.offsets) == len(got.clear) == len(got.contrast) == 0


def test_what_is_bright_outside_is_no_edge_of_the_arm():
    pixels, normals = np.array([[40.0, 20]]), np.array([[-1.0, 0]])
    assert not find_edges(step_picture(41), pixels, normals, 6.0).clear.any()


def test_nothing_is_found_where_nothing_is_or_the_background_is_unknown():
    pixels, normals = np.array([[40.0, 20]]), np.array([[1.0, 0]])
    flat = np.random.default_rng(0).normal(0, 3, (40, 80, 3)).astype(np.float32)
    assert not find_edges(flat, pixels, normals, 6.0).clear.any()
    hidden = step_picture(40)
    hidden[:, 30:50] = np.nan
    assert not find_edges(hidden, pixels, normals, 6.0).clear.any()


def test_the_background_is_the_median_of_what_is_not_covered():
    rgb = np.stack([np.full((4, 5, 3), v, np.uint8) for v in (10, 20, 200, 30)])
    covered = np.zeros((4, 4, 5), bool)
    covered[2, :2] = True
    covered[:, 2] = True
    behind = behind_arm(rgb, covered)
    np.testing.assert_array_equal(behind[:2], 20)
    assert np.isnan(behind[2:]).all()
    covered[0, 0] = True
    np.testing.assert_array_equal(behind_arm(rgb, covered)[0], 25)
