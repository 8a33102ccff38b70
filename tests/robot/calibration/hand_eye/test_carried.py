"""`jaxcam.calibrate hand-eye --mount grip` as a command: the board lies, the camera moves."""

import json

import numpy as np
import pytest
from drawn import Print, draw
from running import exit_code
from scipy.spatial.transform import Rotation
from tagged import all_rays, grip_states, write_hand
from web_page import Page

from jaxcam.interop.recordings import read_recording
from jaxcam.robot.calibration.boards import Board
from jaxcam.robot.calibration.projection import apart, moved, pose_of

BOARD = Board("charuco", 7, 5, 0.03, 0.021, "4x4_50")
AIM = np.array([0.45, 0.0, 0.0])
"""The board's middle; the hand is 40 cm above it."""
GRIP_FROM_CAMERA = moved(np.eye(4), np.array([0.05, 0.02, 0.06, 0.12, -0.1, 0.3]))
ASKED = ("calibrate", "hand-eye", "data", "--view", "front", "--mount", "grip", "--target",
         "charuco", "--columns", "7", "--rows", "5", "--square-mm", "30")  # fmt: skip


def board_on_the_table():
    ink = np.pad(BOARD.drawn(64), 64, constant_values=255)
    width, height = (BOARD.columns + 2) * BOARD.square, (BOARD.rows + 2) * BOARD.square
    facing_up = Rotation.from_euler("x", np.pi).as_matrix()
    return Print(
        ink, width, height, pose_of(facing_up, AIM + np.array([-width / 2, height / 2, 0]))
    )


@pytest.fixture(scope="module")
def film():
    """States and pictures: in each of three episodes the hand stops at six places."""
    rng, paper = np.random.default_rng(1), board_on_the_table()
    down, states, pictures = Rotation.from_euler("x", np.pi), [], []
    for _ in range(3):
        turns = Rotation.from_rotvec(rng.uniform(-0.4, 0.4, (6, 3)))
        above = AIM + np.array([0, 0, 0.4]) + rng.uniform(-0.06, 0.06, (6, 3))
        six = pose_of((turns * down).as_matrix(), above)
        shown = [draw(all_rays(), g @ GRIP_FROM_CAMERA, [paper], rng, samples=2) for g in six]
        pictures.append(np.repeat(np.stack(shown), 3, 0))
        states.append(np.repeat(grip_states(six), 3, 0))
    return states, pictures


@pytest.fixture
def place(tmp_path, monkeypatch, film):
    return write_hand(tmp_path, monkeypatch, *film)


def test_each_picture_of_a_camera_on_the_hand_gets_its_pose(place, capsys, film):
    assert exit_code(*ASKED) == 0
    assert "ood enough" in capsys.readouterr().out
    view = json.loads((place / "cameras.json").read_text())["views"]["front"]
    assert "grip_from_camera" in view
    assert "base_from_camera" not in view
    recording = read_recording(place / "data", place / "cameras.json")
    for episode, state in zip(recording.episodes, film[0], strict=True):
        grips = pose_of(Rotation.from_rotvec(state[:, 3:]).as_matrix(), state[:, :3])
        got = episode.sights["front"].calibration.base_from_camera
        for true, camera in zip(grips @ GRIP_FROM_CAMERA, got, strict=True):
            distance, angle = apart(true, camera)
            assert distance < 0.003
            assert angle < np.deg2rad(0.3)
    page = Page(place / "hand-eye-front.html")
    assert "board" in page.text


@pytest.mark.parametrize(
    ("flag", "value", "match"),
    [
        ("--mount", "fixed", "With --mount grip they do"),
        ("--square-mm", "25", "but by the hand's motion it is"),
        ("--columns", "8", "8x5"),
    ],
)
def test_what_is_wrong_of_it_is_said(place, capsys, flag, value, match):
    words = list(ASKED)
    words[words.index(flag) + 1] = value
    assert exit_code(*words) in (2, 3)
    assert match in " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert "grip_from_camera" not in (place / "cameras.json").read_text()
