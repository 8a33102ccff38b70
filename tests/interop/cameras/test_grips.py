"""Which numbers of a state are the grip's pose."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxcam.errors import ConfigError, DatasetError
from jaxcam.interop.cameras.grips import (
    GripEntries,
    grip_numbers,
    poses_between,
    poses_of_grip,
)

PLACE = ("ee_x", "ee_y", "ee_z")
TURN = Rotation.from_euler("xyz", [0.3, -0.4, 0.5])
FORMS = {
    "rotvec": TURN.as_rotvec(),
    "quaternion_xyzw": TURN.as_quat(),
    "quaternion_wxyz": np.roll(TURN.as_quat(), 1),
    "euler_xyz": TURN.as_euler("xyz"),
    "euler_zyx_intrinsic": TURN.as_euler("ZYX"),
}


@pytest.mark.parametrize(
    ("names", "form", "columns"),
    [
        ((*PLACE, "ee_rx", "ee_ry", "ee_rz"), "rotvec", (3, 4, 5)),
        ((*PLACE, "qx", "qy", "qz", "qw", "gripper"), "quaternion_wxyz", (6, 3, 4, 5)),
        (("gripper", *PLACE, "ee_roll", "ee_pitch", "ee_yaw"), "euler_xyz", (4, 5, 6)),
    ],
)
def test_names_say_it(names, form, columns):
    numbers = grip_numbers(names, GripEntries())
    assert (numbers.form, numbers.rotation) == (form, columns)


@pytest.mark.parametrize("form", sorted(FORMS))
def test_each_form_is_a_rotation(form):
    values = FORMS[form]
    said = GripEntries(f"observation.state[1:{4 + len(values)}]", form)
    numbers = grip_numbers("abcdefghij", said)
    state = np.concatenate([[9], [0.1, 0.2, 0.3], values, np.zeros(10 - 4 - len(values))])
    pose = poses_of_grip(state[None].astype(np.float32), numbers, "here")[0]
    np.testing.assert_allclose(pose[:3, :3], TURN.as_matrix(), atol=1e-6)
    np.testing.assert_allclose(pose[:3, 3], [0.1, 0.2, 0.3], atol=1e-6)


@pytest.mark.parametrize(
    ("text", "form", "match"),
    [
        ("", "by_names", "do not say where the grip's position"),
        ("observation.state[0:5]", "rotvec", "six columns"),
        ("observation.state[6:12]", "rotvec", "of 10 that there are"),
        ("observation.state[0:6]", "by_names", "Give --rotation: rotvec, euler_xyz"),
        ("observation.state[0:6]", "quaternion_wxyz", "has 4 numbers"),
    ],
)
def test_what_nobody_says_is_asked_for(text, form, match):
    with pytest.raises(ConfigError, match=match):
        grip_numbers("abcdefghij", GripEntries(text, form))


@pytest.mark.parametrize(
    ("state", "form", "match"),
    [
        ([400.0, 0, 0, 0, 0, 0], "rotvec", "millimetres"),
        ([0.4, 0, 0, 0, 0, 90.0], "euler_xyz", "degrees"),
        ([0.4, 0, 0, 1, 1, 0, 0], "quaternion_wxyz", "length 1.41"),
        ([np.nan, 0, 0, 0, 0, 0], "rotvec", "not finite"),
    ],
)
def test_numbers_that_are_no_poses(state, form, match):
    numbers = grip_numbers("abcdefghij", GripEntries(f"state[0:{len(state)}]", form))
    with pytest.raises(DatasetError, match=match):
        poses_of_grip(np.array([state]), numbers, "here")


def test_a_file_that_does_not_say_it_is_named():
    with pytest.raises(ConfigError, match=r"cameras\.json: view 'a': pose names six columns"):
        grip_numbers("abcdefghij", GripEntries("state[0:99]"), "cameras.json: view 'a'")
    with pytest.raises(ConfigError, match=r"delay_ms"):
        GripEntries(delay_ms=float("nan"))


def test_between_two_moments_the_hand_is_halfway():
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = [0, 1, 3]
    poses[1, :3, :3] = Rotation.from_rotvec([0, 0, 0.8]).as_matrix()
    between = poses_between(poses, np.array([0.5, 1.5, -4.0, 9.0, 1.0]))
    np.testing.assert_allclose(between[:, 0, 3], [0.5, 2, 0, 3, 1])
    turns = Rotation.from_matrix(between[:, :3, :3]).magnitude()
    np.testing.assert_allclose(turns, [0.4, 0.4, 0, 0, 0.8], atol=1e-9)
    np.testing.assert_array_equal(poses_between(poses[:1], np.array([0.3]))[0], poses[0])
