"""Pictures of a board that no single lens explains."""

import numpy as np
import pytest
from seen_boards import BOARD, SIZE, board_poses, optics, seen

from jaxcam.errors import DatasetError
from jaxcam.robot.calibration.lens.faults import board_shape, fit_checked
from jaxcam.robot.calibration.lens.fit import fit_lens


def good(count=12, seed=0, **more):
    rng = np.random.default_rng(seed)
    return seen(optics(), board_poses(rng, count, far=0.25), rng, **more)


def test_good_pictures_pass():
    fit, left_out = fit_checked(BOARD, good(), SIZE, "opencv", 4)
    assert left_out == []
    assert len(fit.views) == 12


def test_pictures_of_two_cameras_are_told_apart():
    rng = np.random.default_rng(1)
    other = seen(optics(480.0), board_poses(rng, 6, far=0.2), rng, name="other")
    with pytest.raises(DatasetError, match=r"two cameras.*zoom or focus.*6 with.*6 with") as caught:
        fit_checked(BOARD, good(6) + other, SIZE, "opencv", 4)
    assert "480" in str(caught.value)
    assert "600" in str(caught.value)


def test_one_picture_of_something_else_is_left_out_and_named():
    views = good()
    views[4].pixels[:] += np.random.default_rng(0).uniform(-6, 6, views[4].pixels.shape)
    fit, left_out = fit_checked(BOARD, views, SIZE, "opencv", 4)
    assert len(fit.views) == 11
    assert "p4" in left_out[0]


def test_a_bent_board_is_refused():
    x = BOARD.points[:, 0] - BOARD.points[:, 0].mean()
    bow = np.c_[np.zeros((len(x), 2)), 0.6 * x**2 / abs(x).max()]  # 4.5 cm from a side: some mm
    with pytest.raises(DatasetError, match=r"not flat.*mm off"):
        fit_checked(BOARD, good(shape=bow), SIZE, "opencv", 4)


def test_the_shape_of_a_flat_board_explains_nothing():
    fit = fit_lens(BOARD.points, good(20), SIZE)
    shape = board_shape(BOARD, fit)
    assert abs(shape.explained) < 0.3
    assert np.nanmax(np.abs(shape.height)) < 1e-3
