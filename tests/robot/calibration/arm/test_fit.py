"""From pictures to a pose without a start, and when that is refused."""

from dataclasses import replace

import numpy as np
import pytest
from boxed_arm import CAMERA, boxed_arm, film

from jaxcam.errors import DatasetError
from jaxcam.robot.calibration.arm.fit import fit_arm
from jaxcam.robot.calibration.projection import apart


def test_the_camera_is_found_from_nothing():
    fit = fit_arm(boxed_arm(), film([CAMERA] * 4))
    place, turn = apart(CAMERA, fit.base_from_camera)
    assert place < 0.015
    assert turn < np.deg2rad(0.8)
    assert fit.support > 0.4
    assert fit.late is None


def test_too_little_motion():
    still = film([CAMERA] * 2, count=3)
    still = replace(still, angles=0.01 * still.angles)
    with pytest.raises(DatasetError, match=r"Too little motion.*expected 0.15"):
        fit_arm(boxed_arm(), still)


def test_an_arm_that_is_not_in_view():
    away = film([CAMERA] * 2, count=3)
    away = replace(away, rgb=np.full_like(away.rgb, 90))
    with pytest.raises(DatasetError, match="not in view"):
        fit_arm(boxed_arm(), away)


def test_pictures_of_other_motions_are_refused():
    shown, other = film([CAMERA] * 3, count=4), film([CAMERA] * 6, count=4)
    wrong = replace(shown, angles=other.angles[12:][::-1].copy())
    with pytest.raises(DatasetError, match=r"explain|does not tell"):
        fit_arm(boxed_arm(), wrong)
