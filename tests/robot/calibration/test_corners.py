"""Corners of a chessboard, against where they were drawn."""

import cv2
import numpy as np
import pytest

from jaxcam.robot.calibration.corners import refine_board, refine_crossings

SIDE, FINE = 24.0, 8
POINTS = np.stack(np.meshgrid(np.arange(1.0, 5), np.arange(1.0, 4)), -1).reshape(-1, 2)
CLEAR = np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]])


def plane(turn):
    """Pixels from squares: turned, and seen from one side."""
    c, s = SIDE * np.cos(turn), SIDE * np.sin(turn)
    return np.array([[c, -s, 40], [s, c, 30 - 40 * turn], [0.02, 0.01, 1]])


def shown(turn, noise=4.0, blur=0.8, seed=0):
    """A picture of a chessboard, and its corners as OpenCV counts pixels."""
    v, u = np.indices((130 * FINE, 150 * FINE)) / FINE
    at = np.stack([u - 0.5 + 0.5 / FINE, v - 0.5 + 0.5 / FINE, np.ones_like(u)], -1)
    at = at @ np.linalg.inv(plane(turn)).T
    x, y = at[..., 0] / at[..., 2], at[..., 1] / at[..., 2]
    white = (np.floor(x) + np.floor(y)) % 2 == 0
    light = np.where((x > 0) & (x < 5) & (y > 0) & (y < 4), np.where(white, 200.0, 30), 120)
    light = cv2.resize(light, (150, 130), interpolation=cv2.INTER_AREA)
    light = cv2.GaussianBlur(light, (0, 0), blur) * np.linspace(0.8, 1.1, 150)
    light = light + np.random.default_rng(seed).normal(0, noise, light.shape)
    pixels = np.c_[POINTS, np.ones(len(POINTS))] @ plane(turn).T
    return np.clip(np.rint(light), 0, 255).astype(np.uint8), pixels[:, :2] / pixels[:, 2:]


def off(one, other):
    return float(np.sqrt(((one - other) ** 2).sum(-1).mean()))


@pytest.mark.parametrize("turn", [0.0, 0.3])
def test_corners_are_found_to_hundredths_of_a_pixel(turn):
    grey, true = shown(turn)
    rough = true + np.random.default_rng(1).uniform(-0.4, 0.4, true.shape)
    got = refine_board(grey, POINTS, rough, CLEAR)
    ending = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
    theirs = cv2.cornerSubPix(grey, rough[:, None].astype(np.float32), (6, 6), (-1, -1), ending)
    assert off(got, true) < 0.04
    assert off(got, true) < off(theirs[:, 0], true) / 1.5


def test_what_is_no_corner_stays_where_it_was():
    grey = np.full((60, 60), 90, np.uint8)
    grey[:, 30:] = 200  # an edge, and nothing that crosses it
    rough = np.array([[29.0, 30.0], [10.0, 10.0], [1.0, 1.0]])
    along = np.tile(np.eye(2), (3, 1, 1))
    got = refine_crossings(grey, rough, along, np.full(3, 6.0))
    np.testing.assert_array_equal(got[1:], rough[1:])
    assert np.linalg.norm(got[0] - rough[0]) < 1


def test_little_room_changes_nothing():
    grey, true = shown(0.1)
    rough = true + 0.3
    np.testing.assert_array_equal(refine_board(grey, POINTS, rough, 0.05 * CLEAR), rough)


def test_corners_on_a_line_have_no_plane():
    grey, true = shown(0.0)
    line = np.c_[np.arange(4.0), np.zeros(4)]
    got = refine_board(grey, line, true[:4], CLEAR)
    assert np.isfinite(got).all()
    assert off(got, true[:4]) < 1
