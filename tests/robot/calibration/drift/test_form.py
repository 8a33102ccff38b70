"""`jaxcam.calibrate drift` as a command."""

from pathlib import Path

import numpy as np
from boxed_arm import CAMERA
from boxed_dataset import write_boxed
from running import exit_code
from web_page import Page

from jaxcam.data.recorded.recording import Recording
from jaxcam.interop.cameras.files import read_cameras
from jaxcam.interop.cameras.optics import Optics
from jaxcam.robot.calibration.drift.change import AskedChange, judged_changes
from jaxcam.robot.calibration.drift.change import Tested as Judged
from jaxcam.robot.calibration.drift.form import ViewDrift, drift_words
from jaxcam.robot.calibration.projection import apart, moved

ELSEWHERE = moved(CAMERA, np.r_[0.01, 0.01, 0, np.deg2rad([1.5, -1.0, 0.0])])
OPTICS = Optics(np.array([[100.0, 0, 60], [0, 100, 40], [0, 0, 1]]), 120, 80, np.zeros(9))
RECORDING = Recording(Path("cups"), ("front",), (), (), 10.0, [], "")
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


def found(change, together, support=0.8, sigma=0.001):
    covariance = sigma**2 * np.eye(6)
    asked = AskedChange(4, CAMERA, np.add(change, together), covariance, support, np.zeros(3))
    return Judged(asked, np.array(change, float), 1.0, False)


def test_a_given_pose_that_is_off_in_all_episodes_is_no_camera_that_stood_right():
    still, off = np.zeros(6), np.r_[0.05, 0, 0, 0, 0, 0]
    (line,) = drift_words(RECORDING, ViewDrift("front", [found(still, still)], [], OPTICS))
    assert "stood still in 1 episode" in line
    told_off, _ = drift_words(RECORDING, ViewDrift("front", [found(still, off)], [], OPTICS))
    assert "ask together for 50 mm and 0.0 degrees" in told_off


def test_pictures_that_say_nothing_are_no_camera_that_stood_still():
    silent = [found(np.zeros(6), np.zeros(6), support=0.1).asked]
    (line,) = drift_words(RECORDING, ViewDrift("front", [], silent, OPTICS))
    assert "nothing can be said of episodes 4" in line
    assert line.endswith("the arm is hardly in view.")


def test_a_camera_that_is_elsewhere_in_every_episode_is_not_said_to_stand_still():
    """Deviations then grow with how neighbours differ, until nothing stands out."""
    rng = np.random.default_rng(0)
    changes = rng.normal(size=(20, 6)) * np.repeat([0.02, np.deg2rad(1.0)], 3)
    covariance = np.diag(np.repeat([0.0015, np.deg2rad(0.07)], 3) ** 2)
    asked = [AskedChange(e, CAMERA, c, covariance, 0.8, np.zeros(3)) for e, c in enumerate(changes)]
    (line,) = drift_words(RECORDING, ViewDrift("front", judged_changes(asked), [], OPTICS))
    assert "elsewhere in almost every episode" in line
