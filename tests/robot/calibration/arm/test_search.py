"""The coarse search: from which side the arm was seen."""

import numpy as np
import pytest
from boxed_arm import CAMERA, SIDE, boxed_arm, film

from jaxcam.robot.calibration.arm.search import FINE, changed, changes_of, search
from jaxcam.robot.calibration.projection import apart, moved


@pytest.fixture(scope="module")
def changes():
    return changes_of(boxed_arm(), film([CAMERA] * 3))


@pytest.fixture(scope="module")
def finer():
    return changes_of(boxed_arm(), film([CAMERA] * 3), FINE)


def test_the_true_pose_explains_most(changes):
    others = [CAMERA, *(moved(CAMERA, np.r_[np.zeros(3), x]) for x in 0.15 * np.eye(3))]
    fits = changes.fits(np.stack(others))
    assert fits[0] > 0.4
    assert (fits[1:] < fits[0]).all()


def test_a_camera_that_looks_away_explains_nothing(changes):
    away = CAMERA.copy()
    away[:3, :3] = CAMERA[:3, :3] @ np.diag([1.0, -1, -1])
    assert changes.fits(away[None])[0] < 0.01


def test_the_search_comes_near(changes, finer):
    poses, fits = search(changes, finer)
    place, turn = apart(CAMERA, poses[0])
    assert place < 0.15
    assert turn < np.deg2rad(10)
    assert (np.diff(fits) <= 0).all()


def test_masks_of_another_tool_are_what_changes():
    from dataclasses import replace

    masks = np.zeros((2, SIDE, SIDE), bool)
    masks[0, 10:20], masks[1, 15:30] = True, True
    both = replace(film([CAMERA], count=2), masks=masks)
    rows = np.flatnonzero(changed(both, 0, 1)[:, 0])
    np.testing.assert_array_equal(rows, [*range(10, 15), *range(20, 30)])
