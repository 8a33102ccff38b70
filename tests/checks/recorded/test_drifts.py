"""Cameras held against their poses by the arm, where nothing else tells."""

import numpy as np
from boxed_arm import CAMERA
from boxed_dataset import write_boxed

from jaxcam.checks.findings import bad, good, note
from jaxcam.checks.recorded.drifts import check_drift, unanswered
from jaxcam.checks.recorded.judged import Judged
from jaxcam.interop.recordings import read_recording
from jaxcam.robot.calibration.projection import moved

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


def test_views_that_what_never_moves_has_answered_are_not_asked_again(tmp_path, monkeypatch):
    write_boxed(tmp_path, monkeypatch, [CAMERA] * 3, CAMERA)
    recording = read_recording(tmp_path / "data", tmp_path / "cameras.json")
    front = "view front"
    assert unanswered(recording, [Judged(note("standing still", got="not known", where=front))])
    for answer in (good("standing still", got="in 3", where=front),
                   bad("standing still", got="moved", where=f"{front}, episode 2")):  # fmt: skip
        assert unanswered(recording, [Judged(answer)]) == []
