"""`jaxcam.calibrate drift` as a command."""

from pathlib import Path

import numpy as np
from boxed_arm import CAMERA
from boxed_dataset import write_boxed
from running import exit_code
from web_page import Page

from jaxcam.data.recorded.recording import Episode, Recording
from jaxcam.interop.calibrations import pose_before
from jaxcam.interop.cameras.files import read_cameras
from jaxcam.interop.cameras.optics import Optics
from jaxcam.interop.recordings import read_recording
from jaxcam.robot.calibration.drift.change import AskedChange, judged_changes
from jaxcam.robot.calibration.drift.change import Tested as Judged
from jaxcam.robot.calibration.drift.form import drift_words
from jaxcam.robot.calibration.drift.looking import ViewDrift
from jaxcam.robot.calibration.projection import apart, moved

ARM = np.array([0.0, 0.0, 1.0])
ELSEWHERE = moved(CAMERA, np.r_[0.01, 0.01, 0, np.deg2rad([1.5, -1.0, 0.0])])
OPTICS = Optics(np.array([[100.0, 0, 60], [0, 100, 40], [0, 0, 1]]), 120, 80, np.zeros(9))
NOTHING = np.zeros((1, 0), np.float32)
RECORDING = Recording(
    Path("cups"), ("front",), (), (), 10.0,
    [Episode(str(number), NOTHING, NOTHING, "", {}) for number in range(16)], "",
)  # fmt: skip
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


def test_episodes_between_and_beside_those_that_were_looked_at(tmp_path, monkeypatch, capsys):
    """Of five, three are looked at; the last has moved, so the one before it is looked at, too."""
    monkeypatch.chdir(tmp_path)
    write_boxed(tmp_path, monkeypatch, [CAMERA] * 3 + [ELSEWHERE] * 2, CAMERA)
    assert exit_code(*ASKED, "--episodes", "3", "--write") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "from episode 3 on, to episode 4" in said, said
    assert list(read_cameras(tmp_path / "cameras.json").episodes) == ["3", "4"]


def test_a_pose_that_would_not_count_is_not_written(tmp_path, monkeypatch, capsys):
    """The dataset's own file comes before the one that is named."""
    monkeypatch.chdir(tmp_path)
    write_boxed(tmp_path, monkeypatch, [CAMERA] * 3, CAMERA)
    (tmp_path / "cameras.json").rename(tmp_path / "data/meta/jaxcam.json")
    assert exit_code(*ASKED, "--write") != 0
    said = "".join(capsys.readouterr().err.replace("│", " ").split())  # the box breaks paths
    assert "meta/jaxcam.jsoncomesfirst" in said
    assert not (tmp_path / "cameras.json").exists()
    recording = read_recording(tmp_path / "data")
    assert pose_before(recording, "front", tmp_path / "data/meta/jaxcam.json") == ""


def test_a_file_of_calibrations_that_is_not_there(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_boxed(tmp_path, monkeypatch, [CAMERA] * 3, CAMERA)
    assert exit_code(*ASKED, "--cameras", "typo.json") != 0
    said = "".join(capsys.readouterr().err.replace("│", " ").split())
    assert "typo.json:nosuchfile." in said


def test_no_pose_is_known(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_boxed(tmp_path, monkeypatch, [CAMERA] * 3)
    assert exit_code(*ASKED) != 0
    assert "No pose that stands still is known" in " ".join(
        capsys.readouterr().err.replace("│", " ").split()
    )


def found(change, together, support=0.8, sigma=0.001):
    covariance = sigma**2 * np.eye(6)
    asked = AskedChange(4, CAMERA, np.add(change, together), covariance, support, np.zeros(3), ARM)
    return Judged(asked, np.array(change, float), 1.0, False)


def test_a_given_pose_that_is_off_in_all_episodes_is_no_camera_that_stood_right():
    still, off = np.zeros(6), np.r_[0.05, 0, 0, 0, 0, 0]
    stood = ViewDrift("front", [found(still, still)] * 2, [], OPTICS)
    assert drift_words(RECORDING, stood) == ["View front: stood still in 2 episodes."]
    assert stood.stood_still
    wrong = ViewDrift("front", [found(still, off)] * 2, [], OPTICS)
    assert "ask together for 50 mm and 0.0 degrees" in drift_words(RECORDING, wrong)[0]
    assert not wrong.stood_still


def test_one_episode_alone_tells_nothing():
    alone = ViewDrift("front", [found(np.zeros(6), np.zeros(6))], [], OPTICS)
    (line,) = drift_words(RECORDING, alone)
    assert "episode 4 alone says something" in line
    assert not alone.stood_still


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
    asked = [
        AskedChange(e, CAMERA, c, covariance, 0.8, np.zeros(3), ARM) for e, c in enumerate(changes)
    ]
    (line,) = drift_words(RECORDING, ViewDrift("front", judged_changes(asked), [], OPTICS))
    assert "elsewhere in almost every episode" in line
