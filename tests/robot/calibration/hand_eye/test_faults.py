"""What would explain pictures that the grip's poses do not."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tagged import OPTICS, eye

from jaxcam.config.calibrate import HandEyeConfig
from jaxcam.errors import DatasetError
from jaxcam.interop.cameras.grips import GripNumbers
from jaxcam.robot.calibration.hand_eye.faults import Case, delay_of, fit_shots, is_late
from jaxcam.robot.calibration.hand_eye.fit import Seen
from jaxcam.robot.calibration.hand_eye.shots import Shots
from jaxcam.robot.calibration.pictures import NamedPicture
from jaxcam.robot.calibration.projection import apart, pixels_of, placed, pose_of
from jaxcam.robot.calibration.tags.places import square

SIZE, AIM, RATE = 0.06, np.array([0.45, 0.0, 0.2]), 20.0
CAMERA = eye(far=0.7, aim=AIM)
DOWN = Rotation.from_euler("x", np.pi)
TAG = np.linalg.inv(pose_of(DOWN.as_matrix(), AIM)) @ pose_of(
    CAMERA[:3, :3]
    @ Rotation.from_euler("xyz", [0.3, -0.2, 0.1]).as_matrix()
    @ np.diag([1, -1, -1]),
    AIM - 0.05 * CAMERA[:3, 2],
)
COLUMNS = GripNumbers((0, 1, 2), (3, 4, 5), "rotvec")
ASKED = HandEyeConfig("data", view="front", size_mm=60.0)


def hand(moments):
    """Poses of a hand that goes about and rests, ten steps each, [n, 4, 4]."""
    t = (10 * (moments // 20) + np.minimum(moments % 20, 10)) * 2 / RATE
    place = np.stack([0.1 * np.sin(1.3 * t), 0.1 * np.sin(0.9 * t + 1), 0.07 * np.sin(1.7 * t)], -1)
    turn = np.stack([np.sin(1.1 * t), np.sin(0.8 * t + 2), np.sin(0.6 * t + 1)], -1) * 0.5
    return pose_of((DOWN * Rotation.from_rotvec(turn)).as_matrix(), AIM + place)


def filmed(late=0.0, size=SIZE, rests=True):
    """Shots of that hand, whose states are late; of one that never rests otherwise."""
    rng, steps = np.random.default_rng(0), np.arange(420)
    poses = hand(steps - late)
    states = np.concatenate(
        [poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3]).as_rotvec()], -1
    )
    chosen = 20 + 20 * np.repeat(np.arange(19), 2) + np.tile([5, 15], 19)
    moving = np.tile([True, False], 19)
    if not rests:
        chosen = chosen - np.where(moving, 0, 12)
    sights = []
    sights = []
    for moment in chosen:
        there = np.linalg.inv(CAMERA) @ hand(np.array([moment]))[0] @ TAG
        pixels = pixels_of(placed(there, square(size)), OPTICS)
        sights.append(Seen(square(SIZE), pixels + rng.normal(0, 0.05, pixels.shape)))
    picture = NamedPicture("a", np.zeros((2, 2, 3), np.uint8))
    shots = Shots(np.zeros(38, int), chosen, moving, tuple(sights), (picture,) * 38, {0: states})
    return Case(shots, COLUMNS, OPTICS, 0.0, RATE)


def test_a_delay_is_estimated_from_a_hand_in_motion():
    case = filmed(late=2.4)
    fit = fit_shots(case, ASKED)
    assert apart(fit.mount_from_camera, CAMERA)[0] < 0.003
    delay = delay_of(case, fit)
    assert delay.steps == pytest.approx(2.4, abs=0.05)
    assert "120 ms (2.4 steps" in delay.words
    assert delay.flag == "--delay-ms 120"
    assert is_late(delay, 0.0)
    assert not is_late(delay, 2.4)


def test_states_in_time_are_not_late():
    case = filmed()
    assert not is_late(delay_of(case, fit_shots(case, ASKED)), 0.0)


def test_pictures_and_states_of_other_moments_are_named_with_the_delay():
    with pytest.raises(DatasetError, match=r"States are 1[45]\d ms .*earlier.*--delay-ms -1[45]\d"):
        fit_shots(filmed(late=-3.0, rests=False), ASKED)


def test_a_tag_of_another_size_is_named():
    with pytest.raises(DatasetError, match=r"--size-mm 60 is .*by the hand's motion it is 4[78]"):
        fit_shots(filmed(size=0.048), ASKED)


def test_no_motion_tells_no_delay():
    case = filmed()
    assert delay_of(case.at_rest, fit_shots(case, ASKED)) is None
