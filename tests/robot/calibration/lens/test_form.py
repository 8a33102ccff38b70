"""`jaxcam.calibrate lens` as a command."""

import json

import cv2
import numpy as np
import pytest
from drawn import Look, boards_shown
from running import exit_code
from web_page import Page

from jaxcam.interop.cameras.files import read_cameras
from jaxcam.robot.calibration.boards import Board

K = np.array([[330.0, 0, 162], [0, 330.5, 119], [0, 0, 1]])
CAMERA = K, (240, 320), (-0.2, 0.05, 4e-4, -3e-4), "opencv"
BOARD = Board("charuco", 7, 5, 0.03, 0.021, "4x4_50")
SHAPE = ("--columns", "7", "--rows", "5", "--square-mm", "30", "--coefficients", "4")


@pytest.fixture(scope="module")
def pictures():
    return list(boards_shown(np.random.default_rng(0), CAMERA, BOARD, 9, Look(0.5, 2.0, 0.3)))


@pytest.fixture
def place(tmp_path, monkeypatch, pictures):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pictures").mkdir()
    for i, picture in enumerate(pictures):
        cv2.imwrite(str(tmp_path / f"pictures/{i}.png"), picture)
    return tmp_path


def test_pictures_of_a_board_give_k_and_lens(place, capsys):
    other = {"format": 1, "views": {"wrist": {"K": K.tolist(), "size": [320, 240]}}}
    (place / "cameras.json").write_text(json.dumps(other))
    assert exit_code("calibrate", "lens", "pictures", "--view", "front", *SHAPE) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "pictures: take 20." in shown
    file = read_cameras(place / "cameras.json")
    assert set(file.views) == {"front", "wrist"}
    off = file.views["front"].optics.K - K
    content = json.loads((place / "cameras.json").read_text())
    sure = content["about"]["calibration"]["front"]["lens"]["deviations"]
    assert abs(off[0, 0]) < 4 * sure["fx"] < 10
    assert abs(off[0, 2]) < 4 * sure["cx"] < 20
    page = Page(place / "lens-front.html")
    assert "nough" in page.text
    assert len(page.attributes("img", "src")) == 9  # six pictures, three figures


@pytest.mark.parametrize(
    ("flags", "match"),
    [
        (("--columns", "5", "--rows", "7"), "Count its squares"),
        (("--columns", "7", "--rows", "5", "--family", "5x5_50"), "--family 4x4_50"),
    ],
)
def test_another_board_than_the_one_that_is_named(place, capsys, flags, match):
    assert exit_code("calibrate", "lens", "pictures", "--view", "front", *flags) == 3
    words = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert match in words
    assert "0 of 9 pictures show the board" in words
    assert not (place / "cameras.json").exists()


def test_the_same_view_again_and_again_does_not_tell_the_lens(place, pictures, capsys):
    rng = np.random.default_rng(0)
    for i in range(9):
        noise = rng.normal(0, 2, pictures[0].shape)
        again = np.clip(pictures[0] + noise, 0, 255).astype(np.uint8)
        cv2.imwrite(str(place / f"pictures/{i}.png"), again)
    assert exit_code("calibrate", "lens", "pictures", "--view", "front", *SHAPE) == 3
    words = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert "do not tell the lens" in words
    assert "by 30 degrees" in words
    assert not (place / "cameras.json").exists()


def test_copies_of_a_picture_count_once(place, capsys):
    first = (place / "pictures/0.png").read_bytes()
    for file in (place / "pictures").iterdir():
        file.write_bytes(first)
    assert exit_code("calibrate", "lens", "pictures", "--view", "front", *SHAPE) == 3
    words = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert "1 of 1 pictures show the board" in words
    assert "Copies do not count: 1.png (of 0.png)" in words


def test_printing(place, capsys):
    assert exit_code("calibrate", "lens", "--print-board", "board.pdf") == 0
    assert "for A4, landscape" in capsys.readouterr().out
    assert (place / "board.pdf").read_bytes().startswith(b"%PDF")
