"""`jaxcam.calibrate drift` as a command."""

import numpy as np
from boxed_arm import CAMERA
from boxed_dataset import write_boxed
from running import exit_code
from web_page import Page

from jaxcam.interop.cameras.files import read_cameras
from jaxcam.robot.calibration.projection import apart, moved

ELSEWHERE = moved(CAMERA, np.r_[0.01, 0.01, 0, np.deg2rad([1.5, -1.0, 0.0])])
ASKED = ("calibrate", "drift", "data", "--robot", "arm.xml")


def test_a_camera_that_moved_is_named_and_its_pose_written(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_boxed(tmp_path, monkeypatch, [CAMERA, CAMERA, ELSEWHERE], CAMERA)
    assert exit_code(*ASKED, "--write") == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "View front: the camera had moved in episode 2" in shown
    file = read_cameras(tmp_path / "cameras.json")
    assert list(file.episodes) == ["2"]
    pose = file.episodes["2"]["front"].pose.of(())
    distance, turn = apart(ELSEWHERE, np.asarray(pose))
    assert distance < 0.015
    assert turn < np.deg2rad(0.8)
    assert "Cameras moved: front from episode 2" in Page(tmp_path / "drift.html").text


def test_a_camera_that_stands_still(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_boxed(tmp_path, monkeypatch, [CAMERA] * 3, CAMERA)
    before = (tmp_path / "cameras.json").read_text()
    assert exit_code(*ASKED, "--write") == 0
    assert "View front: stood still in 3 episodes" in capsys.readouterr().out
    assert (tmp_path / "cameras.json").read_text() == before


def test_no_pose_is_known(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_boxed(tmp_path, monkeypatch, [CAMERA] * 3)
    assert exit_code(*ASKED) != 0
    assert "No pose that stands still is known" in " ".join(
        capsys.readouterr().err.replace("│", " ").split()
    )
