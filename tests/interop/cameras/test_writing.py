"""Files of calibrations are written and updated, and nothing in them is lost."""

import json

import jsonschema
import numpy as np
import pytest
from places import REPO

from jaxcam.errors import ConfigError, JaxcamError
from jaxcam.interop.cameras.files import read_cameras
from jaxcam.interop.cameras.writing import (
    Changes,
    check_updatable,
    optics_json,
    overruled,
    pose_json,
    update_cameras,
)

K = np.array([[600.0, 0, 320.5], [0, 601, 240.25], [0, 0, 1]])
POSE = np.array([[0.0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
LENS = np.array([0.1, -0.2, 1e-4, 2e-4, 0.01])
FRONT = optics_json(K, (640, 480), "opencv", LENS)


def test_a_new_file_is_read_as_it_was_meant(tmp_path):
    path = update_cameras(tmp_path / "cameras.json", Changes({"front": FRONT | pose_json(POSE)}))
    schema = json.loads((REPO / "docs/cameras.schema.json").read_text())
    jsonschema.validate(json.loads(path.read_text()), schema)
    entry = read_cameras(path).views["front"]
    np.testing.assert_allclose(entry.optics.K, K)
    np.testing.assert_allclose(entry.optics.distortion[:5], LENS)
    np.testing.assert_allclose(entry.pose.of(()), POSE, atol=1e-6)


def test_what_is_there_stays(tmp_path):
    path = tmp_path / "cameras.json"
    side = {"K": K.tolist(), "size": [640, 480], "world_from_camera": POSE.tolist()}
    old = {
        "$schema": "cameras.schema.json",
        "format": 1,
        "world_from_base": np.eye(4).tolist(),
        "views": {
            "front": {"K": K.tolist(), "size": [640, 480], "pixel_centers": 0,
                      "world_from_camera": POSE.tolist(), "axes": "opengl"},
            "side": side,
        },
        "episodes": {"3": {"side": {"base_from_camera": POSE.tolist()}}},
        "about": ["by hand"],
    }  # fmt: skip
    path.write_text(json.dumps(old))
    about = {"front": {"pose": {"rms": 0.1}}}
    update_cameras(path, Changes({"front": pose_json(POSE)}, {"3": {"front": FRONT}}, about=about))
    new = json.loads(path.read_text())
    assert new["views"]["side"] == side
    front = new["views"]["front"]
    assert front["pixel_centers"] == 0  # K as it was, the pose instead of the old one
    assert set(front) == {"K", "size", "pixel_centers", "base_from_camera"}
    assert set(new["episodes"]["3"]) == {"side", "front"}
    assert new["about"]["before"] == ["by hand"]
    assert new["about"]["calibration"]["front"]["pose"]["rms"] == 0.1
    assert new["$schema"] == old["$schema"]
    update_cameras(path, Changes({"front": FRONT}, about={"front": {"lens": {"rms": 0.2}}}))
    new = json.loads(path.read_text())
    assert set(new["about"]["calibration"]["front"]) == {"lens", "pose"}
    assert "base_from_camera" in new["views"]["front"]
    assert new["views"]["front"]["pixel_centers"] == 0.5


@pytest.mark.parametrize("content", ["{", "[1]", '{"views": {}}', '{"format": 1, "cams": {}}'])
def test_what_is_no_file_of_calibrations_is_left_alone(tmp_path, content):
    path = tmp_path / "cameras.json"
    path.write_text(content)
    for call in (
        lambda: check_updatable(path),
        lambda: update_cameras(path, Changes({"a": FRONT})),
    ):
        with pytest.raises(JaxcamError, match=r"cameras\.json"):
            call()
    assert path.read_text() == content


def test_what_could_not_be_read_again_is_not_written(tmp_path):
    path = update_cameras(tmp_path / "cameras.json", Changes({"front": FRONT}))
    before = path.read_text()
    with pytest.raises(JaxcamError, match=r"cameras\.json: view 'side'"):
        update_cameras(path, Changes({"side": {"K": [[1, 2]], "size": [640, 480]}}))
    assert path.read_text() == before
    with pytest.raises(ConfigError, match=r"ends in \.json"):
        check_updatable(tmp_path / "cameras.yaml")


def test_poses_of_single_episodes_stay_unless_the_new_one_was_measured_in_all(tmp_path):
    path = update_cameras(
        tmp_path / "cameras.json",
        Changes(
            {"front": FRONT},
            {"1": {"front": pose_json(POSE) | FRONT}, "2": {"front": pose_json(POSE)}},
        ),
    )
    update_cameras(path, Changes({"front": pose_json(POSE)}))
    assert overruled(path, "front") == ["1", "2"]
    update_cameras(path, Changes({"front": pose_json(POSE)}, everywhere=("front",)))
    assert overruled(path, "front") == []
    episodes = json.loads(path.read_text())["episodes"]
    assert set(episodes["1"]["front"]) == set(FRONT)
    assert episodes["2"] == {}


def test_views_and_episodes_keep_the_names_that_a_file_has(tmp_path):
    """A second name would hide K, or be refused as one that is there already."""
    path, link = tmp_path / "cameras.json", tmp_path / "link.json"
    K = {"K": {"fx": 100, "fy": 100, "cx": 60, "cy": 40}, "size": [120, 80], "pixel_centers": 0.5}
    name = "observation.images.front"
    views = {name: K | pose_json(np.eye(4))}
    content = {"format": 1, "views": views, "episodes": {"episode 3": {name: pose_json(POSE)}}}
    path.write_text(json.dumps(content))
    link.symlink_to(path)
    assert overruled(path, "front") == ["episode 3"]
    episodes = {"2": {"front": pose_json(POSE)}, "3": {"front": pose_json(np.eye(4))}}
    called = {"2": "episode 2", "3": "episode 3"}
    update_cameras(link, Changes({"front": pose_json(POSE)}, episodes, called=called))
    assert link.is_symlink()
    written = json.loads(path.read_text())
    assert list(written["views"]) == [name]
    assert list(written["episodes"]) == ["episode 3", "2"]
    file = read_cameras(path)
    for episode, pose in ((("2",), POSE), (("episode 3",), np.eye(4)), ((), POSE)):
        entry = file.of(episode, "front")
        assert entry.optics is not None
        np.testing.assert_allclose(entry.pose.of(()), pose, atol=1e-6)


def test_notes_on_episodes_name_those_before_too(tmp_path):
    path = tmp_path / "cameras.json"

    def noted(about, episodes=(), **more):
        poses = {str(n): {"front": pose_json(POSE)} for n in episodes}
        update_cameras(path, Changes({"front": FRONT}, poses, about={"front": about}, **more))
        notes = json.loads(path.read_text())["about"]["calibration"]["front"]
        return {name: note.get("episodes") for name, note in notes.items()}

    def drift(*episodes):
        return noted({"drift": {"by": "arm", "episodes": [*episodes]}}, episodes)

    assert drift(1, 2) == {"drift": [1, 2]}
    assert drift(2, 7) == {"drift": [1, 2, 7]}
    assert noted({"lens": {"px": 0.1}}) == {"drift": [1, 2, 7], "lens": None}
    assert noted({"arm": {"mm": 2}}, everywhere=("front",)) == {"lens": None, "arm": None}


def test_what_is_known_of_a_pose_stays_as_long_as_the_pose(tmp_path):
    path = tmp_path / "cameras.json"

    def noted(name, episodes):
        poses = {str(n): {"front": pose_json(POSE)} for n in episodes}
        about = {name: {"episodes": episodes}}
        update_cameras(path, Changes(episodes=poses, about={"front": about}))
        notes = json.loads(path.read_text())["about"]["calibration"]["front"]
        return {name: note["episodes"] for name, note in notes.items()}

    one, two, other = {"rms": 0.1}, {"rms": 0.2}, {"rms": 0.3}
    assert noted("tags", {"1": one, "2": two}) == {"tags": {"1": one, "2": two}}
    both = {"1": one, "2": other, "3": other}
    assert noted("tags", {"2": other, "3": other}) == {"tags": both}
    assert noted("drift", [3, 4]) == {"tags": {"1": one, "2": other}, "drift": [3, 4]}
    assert noted("tags", {"3": one}) == {"tags": {"1": one, "2": other, "3": one}, "drift": [4]}
    assert set(noted("tags", {"4": one})) == {"tags"}
