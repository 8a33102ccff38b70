"""`jaxcam.calibrate hand-eye` as a command."""

import json

import numpy as np
import pytest
from running import exit_code
from scipy.spatial.transform import Rotation
from tagged import VIEW, drawn_tags, eye, write_dataset
from web_page import Page

from jaxcam.interop.cameras.files import read_cameras
from jaxcam.robot.calibration.projection import apart, moved, pose_of

SIZE, AIM = 0.08, np.array([0.45, 0.0, 0.2])
CAMERA = eye(far=0.6, aim=AIM)
TAG = moved(
    np.linalg.inv(pose_of(Rotation.from_euler("x", np.pi).as_matrix(), AIM))
    @ pose_of(CAMERA[:3, :3] @ np.diag([1.0, -1, -1]), AIM - 0.05 * CAMERA[:3, 2]),
    np.array([0, 0, 0, 0.5, -0.4, 0.1]),
)
NAMES = ("ee_x", "ee_y", "ee_z", "ee_rx", "ee_ry", "ee_rz")


@pytest.fixture(scope="module")
def film():
    """Poses of the grip, states and pictures: in each episode five, each twice."""
    rng = np.random.default_rng(0)
    poses = []
    for _ in range(3):
        turns = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, (5, 3)))
        rotations = (Rotation.from_euler("x", np.pi) * turns).as_matrix()
        five = pose_of(rotations, AIM + rng.uniform(-0.08, 0.08, (5, 3)))
        poses.append(np.repeat(five, 3, 0))
    states = [
        np.concatenate([p[:, :3, 3], Rotation.from_matrix(p[:, :3, :3]).as_rotvec()], -1)
        .astype(np.float32)
        for p in poses
    ]  # fmt: skip
    pictures = [
        np.repeat(drawn_tags([CAMERA] * 5, [{5: g @ TAG} for g in some[::3]], i), 3, 0)
        for i, some in enumerate(poses)
    ]
    return states, pictures


@pytest.fixture
def place(tmp_path, monkeypatch, film):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cameras.json").write_text(json.dumps({"format": 1, "views": {"front": VIEW}}))
    write_dataset(tmp_path / "data", monkeypatch, film[1], film[0], NAMES)
    return tmp_path


ASKED = ("calibrate", "hand-eye", "data", "--view", "front", "--tag", "5", "--size-mm", "80")


def test_a_dataset_gives_the_cameras_pose(place, capsys):
    assert exit_code(*ASKED) == 0
    shown = capsys.readouterr().out
    assert "ood enough" in shown
    pose = read_cameras(place / "cameras.json").views["front"].pose.of(())
    distance, angle = apart(pose, CAMERA)
    assert distance < 0.003
    assert angle < np.deg2rad(0.3)
    page = Page(place / "hand-eye-front.html")
    assert "tag on the grip" in page.text


@pytest.mark.parametrize(
    ("more", "match"),
    [
        (["--tag", "7"], "Other tags are there: 5"),
        (["--size-mm", "60"], "but by the hand's motion it is"),
        (["--mount", "grip"], "With --mount fixed they do"),
        (["--view", "top"], "--view: unknown 'top'"),
        (["--grip-pose", "observation.state[0:6]", "--rotation", "euler_xyz"],
         "With --rotation rotvec they do"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said(place, capsys, more, match):
    words = list(ASKED)
    for flag, value in zip(more[::2], more[1::2], strict=True):
        if flag in words:
            words[words.index(flag) + 1] = value
        else:
            words += [flag, value]
    assert exit_code(*words) in (2, 3)
    assert match in " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert not (place / "hand-eye-front.html").exists()
