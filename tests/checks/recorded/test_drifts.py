"""Cameras held against their poses by the arm, where nothing else tells."""

import numpy as np
from boxed_arm import CAMERA, SIDE, K
from boxed_dataset import write_boxed

from jaxcam.checks.findings import bad, good, note
from jaxcam.checks.recorded import drifts
from jaxcam.checks.recorded.drifts import check_drift, unanswered
from jaxcam.checks.recorded.judged import Judged
from jaxcam.interop.cameras.optics import Optics
from jaxcam.interop.recordings import read_recording
from jaxcam.robot.calibration.drift.change import AskedChange
from jaxcam.robot.calibration.drift.change import Tested as Told
from jaxcam.robot.calibration.drift.looking import ViewDrift
from jaxcam.robot.calibration.projection import moved

ARM = np.array([0.0, 0.0, 1.0])
ELSEWHERE = moved(CAMERA, np.r_[0.01, 0.01, 0, np.deg2rad([1.5, -1.0, 0.0])])


def test_the_arm_names_the_episode_in_which_a_camera_stood_elsewhere(tmp_path, monkeypatch):
    write_boxed(tmp_path, monkeypatch, [CAMERA, CAMERA, ELSEWHERE], CAMERA)
    recording = read_recording(tmp_path / "data", tmp_path / "cameras.json")
    arm = str(tmp_path / "arm.xml")
    (got,) = check_drift(recording, ["front"], [0, 1, 2], arm)
    assert got.finding.mark == "bad"
    assert got.episodes == (2,)
    assert "by the arm, it stood" in got.finding.got
    (still,) = check_drift(recording, ["front"], [0, 1], arm)
    assert still.finding.mark == "good"


def test_episodes_that_tell_too_little_are_no_camera_that_stood_still(tmp_path, monkeypatch):
    write_boxed(tmp_path, monkeypatch, [CAMERA] * 3, CAMERA)
    recording = read_recording(tmp_path / "data", tmp_path / "cameras.json")
    asked = AskedChange(0, CAMERA, np.zeros(6), 0.05**2 * np.eye(6), 0.8, np.zeros(3), ARM)
    optics = Optics(K, SIDE, SIDE, np.zeros(9))
    drift = ViewDrift("front", [Told(asked, np.zeros(6), 0.0, False)] * 2, [], optics)
    monkeypatch.setattr(drifts, "drift_of", lambda *_: drift)
    (got,) = drifts.check_drift(recording, ["front"], [0, 1, 2], str(tmp_path / "arm.xml"))
    assert (got.finding.mark, got.finding.got) == (
        "note", "not known: an episode tells it to 50 mm, 2.9°"
    )  # fmt: skip


def test_a_pose_that_is_off_in_all_episodes_is_bad(tmp_path, monkeypatch):
    write_boxed(tmp_path, monkeypatch, [CAMERA] * 3, CAMERA)
    recording = read_recording(tmp_path / "data", tmp_path / "cameras.json")
    off = np.r_[0.05, 0, 0, 0, 0, 0]
    asked = AskedChange(0, CAMERA, off, 1e-6 * np.eye(6), 0.8, np.zeros(3), ARM)
    optics = Optics(K, SIDE, SIDE, np.zeros(9))
    drift = ViewDrift("front", [Told(asked, np.zeros(6), 0.0, False)] * 3, [], optics)
    monkeypatch.setattr(drifts, "drift_of", lambda *_: drift)
    still, off = drifts.check_drift(recording, ["front"], [0, 1, 2], str(tmp_path / "arm.xml"))
    assert still.finding.mark == "good"
    assert (off.finding.mark, off.finding.got) == (
        "bad", "by the arm, 50 mm and 0.0° off in all 3 episodes"
    )  # fmt: skip


def test_views_that_what_never_moves_has_answered_are_not_asked_again(tmp_path, monkeypatch):
    write_boxed(tmp_path, monkeypatch, [CAMERA] * 3, CAMERA)
    recording = read_recording(tmp_path / "data", tmp_path / "cameras.json")
    front = "view front"
    assert unanswered(recording, [Judged(note("standing still", got="not known", where=front))])
    for answer in (good("standing still", got="in 3", where=front),
                   bad("standing still", got="moved", where=f"{front}, episode 2")):  # fmt: skip
        assert unanswered(recording, [Judged(answer)]) == []
