"""Pictures of the target, and the moments that they are of."""

import numpy as np

from jaxcam.config.calibrate import HandEyeConfig
from jaxcam.interop.cameras.grips import GripNumbers
from jaxcam.robot.calibration.hand_eye.fit import Seen
from jaxcam.robot.calibration.hand_eye.shots import Shots, board_of
from jaxcam.robot.calibration.pictures import NamedPicture

COLUMNS = GripNumbers((0, 1, 2), (3, 4, 5), "rotvec")


def shots(on_hand=False):
    state, shift = np.zeros((5, 6)), np.eye(6)[0]
    state[:, 0] = np.arange(5) * 0.1
    nothing = Seen(np.zeros((4, 3)), np.zeros((4, 2)))
    picture = NamedPicture("a", np.zeros((2, 2, 3), np.uint8))
    return Shots(np.array([0, 0, 1]), np.array([1, 3, 2]), np.array([False, True, True]),
                 (nothing,) * 3, (picture,) * 3, {0: state, 1: state + shift},
                 on_hand)  # fmt: skip


def test_states_that_are_late_are_those_of_later_steps():
    grips = shots().grips(COLUMNS)
    np.testing.assert_allclose(grips(0.0)[:, 0, 3], [0.1, 0.3, 1.2])
    np.testing.assert_allclose(grips(0.5)[:, 0, 3], [0.15, 0.35, 1.25])


def test_of_a_camera_on_the_hand_the_base_is_what_moves():
    fixed, carried = shots().carried(COLUMNS)(0.0), shots(on_hand=True).carried(COLUMNS)(0.0)
    np.testing.assert_allclose(fixed @ carried, np.tile(np.eye(4), (3, 1, 1)), atol=1e-12)


def test_some_of_them():
    few = shots().some(~shots().moving)
    assert few.steps.tolist() == [1]
    assert len(few.sights) == len(few.pictures) == 1
    assert shots().some(np.array([2, 0])).episodes.tolist() == [1, 0]


def test_boards_as_they_are_named():
    assert board_of(HandEyeConfig("d", view="a")) is None
    board = board_of(HandEyeConfig("d", view="a", target="charuco", columns=7, rows=5))
    assert (board.columns, board.family) == (7, "4x4_50")
