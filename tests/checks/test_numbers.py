"""Numbers of demonstrations that make no sense, and what the doctor says of each."""

import re

import numpy as np
import pytest
from many_cameras import with_errors
from scipy.spatial.transform import Rotation
from spoilt import change_all, findings_in, put, spoil, unsealed

from jaxcam.checks.numbers import check_errors


@pytest.fixture
def copy(demos, tmp_path):
    return unsealed(demos, tmp_path)


CASES = {
    "a gripper from 0 to 1": (
        lambda f: change_all(f, "actions", lambda a: np.hstack([a[:, :6], (a[:, 6:] + 1) / 2])),
        "gripper", "bad", "0 to 1",
    ),
    "a gripper in millimetres": (
        lambda f: change_all(f, "actions", lambda a: np.hstack([a[:, :6], a[:, 6:] * 40])),
        "gripper", "bad", "-40 to 40",
    ),
    "a gripper that never moves": (
        lambda f: change_all(f, "actions", lambda a: np.hstack([a[:, :6], 0 * a[:, 6:] - 1])),
        "gripper", "note", "never changes",
    ),
    "a constant": (
        lambda f: change_all(f, "actions", lambda a: a * (np.arange(7) != 4)),
        "constant commands", "note", "turn y",
    ),
    "commands in millimetres": (
        lambda f: change_all(f, "actions", lambda a: a * ([1000] * 3 + [1] * 4)),
        "commands", "bad", "m from where the grip",
    ),
    "deltas": (
        lambda f: change_all(
            f, "actions",
            lambda a: np.hstack([np.diff(a[:, :3], axis=0, prepend=a[:1, :3]), a[:, 3:]]),
        ),
        "commands", "bad", "m from where the grip",
    ),
    "a leap": (
        lambda f: f["data/demo_3/actions"].__setitem__((20, 0), 0.5), "commands", "note", "leap",
    ),
    "another rate": (
        lambda f: change_all(f, "states", lambda s: s * ([2] + [1] * (s.shape[1] - 1))),
        "rate", "bad", "0.1 to 0.1 s apart",
    ),
    "rotations that leap": (
        lambda f: f["data/demo_3/actions"].__setitem__((20, slice(3, 6)), [0.1, 0.2, 0.3]),
        "rotations", "note", "rad in a control step",
    ),
    "a short one": (
        lambda f: [
            put(f, f"data/demo_1/{name}", f[f"data/demo_1/{name}"][: 6 + (name != "actions")])
            for name in (
                "states", "actions", "obs/robot0_eef_pos", "obs/robot0_eef_quat",
                "obs/robot0_gripper",
            )
        ],
        "lengths", "note", "6 to ",
    ),
}  # fmt: skip


def spin(first, last):
    """Rotations of a grip that points down and turns between two yaws."""

    def change(actions):
        yaw = np.linspace(first, last, len(actions))
        down = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
        turned = Rotation.from_euler("z", yaw[:, None]) * down
        return np.hstack([actions[:, :3], turned.as_rotvec(), actions[:, 6:]])

    return change


@pytest.mark.parametrize(
    ("first", "last", "mark", "words"),
    [
        (0.1, 0.5, "good", "within 0.5 rad of a grip that points down"),
        (-1.0, 1.0, "good", "within 1 rad"),
        (1.0, 2.0, "note", "jump by a turn in 6 of 6 demonstrations"),
        (2.0, 4.0, "note", "within 4 rad"),
    ],
)
def test_jumps_of_rotations_are_found(copy, first, last, mark, words):
    spoil(copy, lambda f: change_all(f, "actions", spin(first, last)))
    finding = findings_in(copy)["rotations"]
    assert finding.mark == mark, finding
    assert words in finding.got


def test_errors_on_purpose_are_counted(demos):
    assert check_errors(demos.episodes).got == "none"
    assert check_errors([with_errors(demos.train[0], 0, 0)]).got == "none"
    half = with_errors(demos.train[0], 0, demos.train[0].length // 2)
    finding = check_errors([half, demos.train[0]])
    assert finding.mark == "good"
    assert re.match(r"2[45]\.\d% of the actions, in 1 demonstrations: not taught", finding.got)


@pytest.mark.parametrize("case", CASES)
def test_what_is_odd_is_found(copy, case):
    change, what, mark, words = CASES[case]
    assert findings_in(copy)[what].mark == "good"
    spoil(copy, change)
    finding = findings_in(copy)[what]
    assert finding.mark == mark, finding
    assert words in finding.got
