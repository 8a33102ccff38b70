"""What the doctor says of a dataset: what cannot be used, copies, and how it replays."""

import numpy as np
import pytest
from spoilt import change_all, findings_in, physics_of, put, spoil, unsealed

from jaxcam.checks.examine import check_dataset
from jaxcam.data.demos import read_demos
from jaxcam.errors import DatasetError


@pytest.fixture
def copy(demos, tmp_path):
    return unsealed(demos, tmp_path)


def copied(file, old, new):
    del file[f"data/demo_{new}"]
    file.copy(f"data/demo_{old}", f"data/demo_{new}")


def test_a_whole_dataset_has_nothing_to_mend(copy):
    findings = findings_in(copy) | physics_of(copy)
    assert {f.mark for f in findings.values()} == {"good"}, findings
    assert {"file", "duplicates", "cameras", "replay, joint_abs", "grip"} <= set(findings)


COPIES = {
    "a copy": (lambda f: copied(f, 0, 2), "duplicates", "bad", "1 are copies"),
    "a leak": (
        lambda f: copied(f, 0, 5), "duplicates", "bad", "1 of them validation copies of training",
    ),
    "a seed twice": (
        lambda f: f["data/demo_1"].attrs.__setitem__("seed", f["data/demo_0"].attrs["seed"]),
        "duplicates", "note", "1 more share an episode's seed",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", COPIES)
def test_copies_are_found(copy, case):
    change, what, mark, words = COPIES[case]
    assert findings_in(copy)[what].mark == "good"
    spoil(copy, change)
    finding = findings_in(copy)[what]
    assert finding.mark == mark, finding
    assert words in finding.got


UNUSABLE = {
    "no steps": (
        lambda f: [put(f, "data/demo_1/actions", np.zeros((0, 7))),
                   put(f, "data/demo_1/states", f["data/demo_1/states"][:1])],
        "0 actions need 1 states",
    ),
    "no number in a state": (
        lambda f: f["data/demo_1/states"].__setitem__((4, 3), np.nan),
        r"non-finite states: 1 of \d+ numbers, the first at step 4",
    ),
    "no number in the grip": (
        lambda f: f["data/demo_1/obs/robot0_eef_pos"].__setitem__((4, 1), np.inf),
        "non-finite eef_pos",
    ),
    "other actions": (
        lambda f: put(f, "data/demo_1/actions", f["data/demo_1/actions"][:, :6]),
        r"actions is \[\d+, 6\], expected \[\d+, 7\]",
    ),
    "other states": (
        lambda f: put(f, "data/demo_1/states", f["data/demo_1/states"][:, 1:]), "states is",
    ),
    "poses of another shape": (
        lambda f: put(f, "cameras/world_from_camera", np.zeros((8, 3, 4))),
        r"world_from_camera is \[8, 3, 4\]",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", UNUSABLE)
def test_what_cannot_be_used_is_refused(copy, case):
    change, words = UNUSABLE[case]
    spoil(copy, change)
    with pytest.raises(DatasetError, match=words):
        read_demos(copy)
    assert findings_in(copy)["file"].mark == "bad"


def test_every_bad_demonstration_is_listed(copy):
    spoil(copy, lambda f: [f[f"data/demo_{i}/actions"].__setitem__(0, np.nan) for i in (0, 3)])
    spoil(copy, lambda f: f.__delitem__("data/demo_4/states"))
    findings = check_dataset(copy, 0).findings
    assert [f.mark for f in findings] == ["bad"] * 3
    for finding, name in zip(findings, ("demo_0", "demo_3", "demo_4"), strict=True):
        assert name in finding.got


def test_rotations_of_few_digits_are_for_the_check_of_cameras_to_refuse(copy):
    def rounded(file):
        poses = file["cameras/world_from_camera"]
        poses[...] = np.round(poses[...], 2)

    spoil(copy, rounded)
    assert findings_in(copy)["camera poses"].mark == "bad"


def test_a_rounded_mirror_stays_a_mirror(copy):
    def mirror(file):
        poses = file["cameras/world_from_camera"]
        poses[...] = np.round(poses[...], 4) @ np.diag([1.0, -1, 1, 1])

    spoil(copy, mirror)
    assert "8 of 8 cameras" in findings_in(copy)["camera poses"].got


def test_commands_that_no_longer_do_what_they_did(copy):
    spoil(copy, lambda f: change_all(f, "actions", lambda a: a * ([1] * 6 + [-1])))
    findings = physics_of(copy)
    assert findings["replay, eef_abs"].mark == "bad"
    assert findings["replay, eef_abs"].where == "demo_0, demo_5"
    assert "0 of 2 succeed" in findings["replay, joint_delta"].got
    assert "gripper's sign" in findings["replay, eef_abs"].fix


def test_objects_that_are_not_where_they_were(copy, scene):
    shift = np.zeros(1 + scene.nq + scene.nv)
    shift[1 + scene.qpos_of("cube")] = 0.06
    spoil(copy, lambda f: change_all(f, "states", lambda s: s + shift))
    findings = physics_of(copy)
    assert findings["replay, joint_abs"].mark == "bad"
    assert "object poses" in findings["replay, joint_abs"].fix
    assert findings["grip"].mark == "good"


def test_a_grip_that_is_not_where_the_joints_put_it(copy):
    spoil(copy, lambda f: change_all(f, "obs/robot0_eef_pos", lambda p: p + np.array([0.02, 0, 0])))
    finding = physics_of(copy)["grip"]
    assert finding.mark == "bad"
    assert "within 20 mm" in finding.got


def late(file):
    positions = file["data/demo_0/obs/robot0_eef_pos"]
    positions[20:] = positions[20:][::-1]


def turn(file):
    """A quarter of a turn about the grip's z."""
    half = np.sqrt(0.5)
    for demo in file["data"].values():
        x, y, z, w = half * demo["obs/robot0_eef_quat"][:].T
        turned = [x + y, y - x, z + w, w - z]
        demo["obs/robot0_eef_quat"][...] = np.stack(turned, -1)


@pytest.mark.parametrize(("change", "words"), [(late, " mm and 0.0°"), (turn, "and 90.0°")])
def test_a_grip_that_leaves_the_joints_later_or_is_turned(copy, change, words):
    spoil(copy, change)
    finding = physics_of(copy)["grip"]
    assert finding.mark == "bad"
    assert words in finding.got
