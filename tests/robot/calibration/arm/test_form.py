"""`jaxcam.calibrate arm` as a command."""

import json

import numpy as np
import pytest
from boxed_arm import CAMERA
from boxed_dataset import write_boxed
from running import exit_code
from web_page import Page

from jaxcam.interop.cameras.files import read_cameras
from jaxcam.robot.calibration.projection import apart

ASKED = ("calibrate", "arm", "data", "--view", "front", "--robot", "arm.xml")


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_boxed(tmp_path, monkeypatch, [CAMERA] * 3)
    return tmp_path


def test_a_dataset_gives_the_cameras_pose(place, capsys):
    assert exit_code(*ASKED) == 0
    shown = capsys.readouterr().out
    assert "enough" in shown
    pose = read_cameras(place / "cameras.json").views["front"].pose.of(())
    distance, turn = apart(CAMERA, np.asarray(pose))
    assert distance < 0.02
    assert turn < np.deg2rad(1)
    about = json.loads((place / "cameras.json").read_text())["about"]["calibration"]["front"]
    assert about["pose"]["by"] == "arm"
    assert about["pose"]["episodes"] == 3
    page = Page(place / "arm-front.html")
    assert "The arm: front" in page.text
    assert "share of the contour" in page.text


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (("--view", "back", "--robot", "arm.xml"), "--view: unknown 'back'"),
        (("--view", "front", "--robot", "panda"), "panda has 7 joints, the state has 3"),
        (("--view", "front", "--robot", "none.urdf"), "no such file"),
        ((*ASKED[3:], "--joints", "state[1:9]"), "--joints names columns"),
        ((*ASKED[3:], "--masks", "none.npz"), "no such file"),
    ],
)
def test_what_does_not_go_together_is_said(place, capsys, asked, message):
    before = (place / "cameras.json").read_text()
    assert exit_code(*ASKED[:3], *asked) != 0
    assert message in " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert (place / "cameras.json").read_text() == before
