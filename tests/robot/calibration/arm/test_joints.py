"""Joint angles by the names of a state's numbers, and by settings."""

from pathlib import Path

import numpy as np
import pytest

from jaxcam.data.recorded.recording import Episode, Recording
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.robot.calibration.arm.joints import joint_numbers, joints_of


def recording(*names):
    return Recording(Path("cups"), ("front",), names, (), 10.0, [], "")


def episode(*row):
    state = np.array([row, row], np.float32)
    return Episode("7", state, state, "", {})


@pytest.mark.parametrize(
    ("names", "angles", "opening", "closes"),
    [
        (("joint_2", "joint_1", "grip_x", "opening"), (1, 0), 3, False),
        (("panda_joint1", "panda_joint2", "gripper"), (0, 1), 2, True),
        (("joint_positions_0", "joint_positions_1"), (0, 1), None, False),
        (("x", "q1.pos", "q2.pos", "gripper_position"), (1, 2), 3, True),
    ],
)
def test_by_their_names(names, angles, opening, closes):
    got = joint_numbers(recording(*names), "", "")
    assert (got.angles, got.opening, got.closes) == (angles, opening, closes)


def test_by_settings():
    got = joint_numbers(recording(*"abcdef"), "observation.state[1:4]", "state[5]")
    assert (got.angles, got.opening) == ((1, 2, 3), 5)


@pytest.mark.parametrize("text", ["state[0:9]", "state[3:3]", "joints", "state[7]"])
def test_settings_that_name_no_columns(text):
    with pytest.raises(ConfigError, match=r"--joints names columns .* of 6 that there are"):
        joint_numbers(recording(*"abcdef"), text, "")


def test_names_that_do_not_say():
    with pytest.raises(ConfigError, match="Give --joints"):
        joint_numbers(recording("x", "y", "z"), "", "")


def test_openings_in_metres_and_those_that_close():
    metres = joint_numbers(recording("joint_1", "opening"), "", "")
    assert joints_of(episode(0.5, 0.04), metres)[1] == pytest.approx([0.5, 0.5])
    closing = joint_numbers(recording("joint_1", "gripper"), "", "")
    assert joints_of(episode(0.5, 0.1), closing)[1] == pytest.approx([0.9, 0.9])


def test_degrees_and_what_is_not_finite_are_refused():
    columns = joint_numbers(recording("joint_1", "joint_2"), "", "")
    with pytest.raises(DatasetError, match=r"Episode '7'.*expected radians.*degrees"):
        joints_of(episode(0.5, 90), columns)
    with pytest.raises(DatasetError, match="not finite"):
        joints_of(episode(0.5, np.nan), columns)
