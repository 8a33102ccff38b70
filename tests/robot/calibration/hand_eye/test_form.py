"""`jaxcam.calibrate hand-eye` as a command."""

import numpy as np
import pytest
from running import exit_code
from scipy.spatial.transform import Rotation
from tagged import drawn_tags, eye, grip_states, write_hand
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
    states = [grip_states(some) for some in poses]
    pictures = [
        np.repeat(drawn_tags([CAMERA] * 5, [{5: g @ TAG} for g in some[::3]], i), 3, 0)
        for i, some in enumerate(poses)
    ]
    return states, pictures


@pytest.fixture
def place(tmp_path, monkeypatch, film):
    return write_hand(tmp_path, monkeypatch, *film)


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
