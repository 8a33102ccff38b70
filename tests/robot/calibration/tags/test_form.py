"""`jaxcam.calibrate tags` as a command."""

import json

import cv2
import numpy as np
import pytest
from running import exit_code
from tagged import FAMILY, SIZE, VIEW, drawn_tags, eye, tag_frames, write_dataset
from web_page import Page

from jaxcam.interop.cameras.files import read_cameras
from jaxcam.interop.recordings import read_recording
from jaxcam.rays.rotations import quaternion_from_matrix
from jaxcam.robot.calibration.projection import apart


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with K of two views and the tags' places, which is the working directory."""
    monkeypatch.chdir(tmp_path)
    front = VIEW | {"base_from_camera": np.eye(4).tolist()}
    content = {"format": 1, "views": {"front": front, "side": VIEW}, "about": "by hand"}
    (tmp_path / "cameras.json").write_text(json.dumps(content))
    tags = {
        str(n): {
            "base_from_tag": {
                "position": frame[:3, 3].tolist(),
                "quaternion_wxyz": np.asarray(quaternion_from_matrix(frame[:3, :3])).tolist(),
            }
        }
        for n, frame in tag_frames().items()
    }
    entries = {"format": 1, "family": FAMILY, "size": SIZE, "tags": tags}
    (tmp_path / "tags.json").write_text(json.dumps(entries))
    return tmp_path


def near(one, other):
    distance, angle = apart(one, other)
    return distance < 0.004 and angle < np.deg2rad(0.4)


def test_pictures_of_a_camera_give_its_pose(place, capsys):
    pose = eye(far=0.6)
    (place / "pictures").mkdir()
    for i, picture in enumerate(drawn_tags([pose] * 2, tag_frames())):
        cv2.imwrite(str(place / f"pictures/{i}.png"), picture[..., ::-1])
    assert exit_code("calibrate", "tags", "pictures", "--view", "front") == 0
    shown = capsys.readouterr().out
    assert "ood enough" in shown
    file = read_cameras(place / "cameras.json")
    assert near(file.views["front"].pose.of(()), pose)
    assert file.views["side"].optics is not None
    content = json.loads((place / "cameras.json").read_text())
    assert content["about"]["before"] == "by hand"
    assert content["about"]["calibration"]["front"]["pose"]["deviation_mm"] < 4
    page = Page(place / "tags-front.html")
    assert "ood enough" in page.text
    assert sum(src.startswith("data:image/png") for src in page.attributes("img", "src")) == 3


def test_episodes_of_a_dataset_give_a_pose_each_where_the_camera_moved(place, monkeypatch, capsys):
    poses = [eye(far=0.6), eye(far=0.6), eye(azimuth=0.7, far=0.65)]
    pictures = [drawn_tags([pose] * 2, tag_frames(), seed=i) for i, pose in enumerate(poses)]
    root = write_dataset(place / "data", monkeypatch, pictures)
    known = {"calibration": {"front": {"pose": {"by": "hand-eye"}}}}
    content = {"format": 1, "views": {"front": VIEW}, "about": known}
    (place / "cameras.json").write_text(json.dumps(content))
    assert exit_code("calibrate", "tags", root) == 0
    assert "front, episode" in capsys.readouterr().out
    recording = read_recording(root, place / "cameras.json")
    for episode, pose in zip(recording.episodes, poses, strict=True):
        assert near(episode.sights["front"].calibration.base_from_camera, pose)
    content = json.loads((place / "cameras.json").read_text())
    assert set(content["episodes"]) == {"0", "1", "2"}
    notes = content["about"]["calibration"]["front"]
    assert notes["pose"] == {"by": "hand-eye"}  # on the view's own pose, as before
    assert set(notes["tags"]["episodes"]) == {"0", "1", "2"}


def test_a_camera_that_stood_still_gets_one_pose(place, monkeypatch):
    pose = eye(far=0.6)
    pictures = [drawn_tags([pose], tag_frames(), seed=i) for i in range(3)]
    root = write_dataset(place / "data", monkeypatch, pictures)
    old = {"1": {"front": {"base_from_camera": np.eye(4).tolist()}}}
    content = {"format": 1, "views": {"front": VIEW}, "episodes": old}
    (place / "cameras.json").write_text(json.dumps(content))
    assert exit_code("calibrate", "tags", root) == 0
    recording = read_recording(root, place / "cameras.json")
    for episode in recording.episodes:
        assert near(episode.sights["front"].calibration.base_from_camera, pose)
    assert json.loads((place / "cameras.json").read_text())["episodes"] == {"1": {}}


@pytest.mark.parametrize(
    ("argv", "match"),
    [
        (["pictures"], "--view is its name"),
        (["pictures", "--view", "top"], "no view 'top'"),
        (["pictures", "--view", "front", "--cameras", "none.json"], "calibrate lens PICTURES"),
        (["nothing", "--view", "front"], "no such file or folder"),
        (["pictures", "--view", "front", "--cameras", "cameras.yaml"], "ends in .json"),
        (["pictures", "--view", "front", "--tags", "cameras.json"], "Unknown setting 'views'"),
    ],
)  # fmt: skip
def test_what_is_missing_is_said(place, capsys, argv, match):
    (place / "pictures").mkdir()
    cv2.imwrite(str(place / "pictures/0.png"), np.full((240, 320, 3), 90, np.uint8))
    before = (place / "cameras.json").read_text()
    assert exit_code("calibrate", "tags", *argv) in (2, 3)
    assert match in " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert (place / "cameras.json").read_text() == before
