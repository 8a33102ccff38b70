"""DROID's raw layout, on episodes that are made here: numbers, pictures, cameras, refusals."""

import json

import numpy as np
import pytest
from droid_files import (
    HEIGHT,
    LENGTH,
    SERIALS,
    SIX,
    UUID,
    WIDTH,
    euler,
    metadata,
    shades,
    wrist_poses,
    write_episode,
)

from jaxcam.errors import CameraError, ConfigError, DatasetError, JaxcamError
from jaxcam.interop.calibrations import calibrated, require_calibrated
from jaxcam.interop.droid.reading import is_droid, read_droid
from jaxcam.interop.formats import recognise

DAY = "LAB/success/2023-03-07/Tue_Mar__7_16:19:59_2023"
K = [40.0, 31.5, 40.0, 17.5]
"""fx, cx, fy, cy as OpenCV counts pixels, of pictures of 1280x720 by 20."""


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """A folder with two episodes, one of which failed."""
    root = tmp_path_factory.mktemp("droid")
    write_episode(root / DAY)
    write_episode(root / "LAB/failure/2023-03-07/later", success=False)
    return root


def greys(sight):
    return [int(picture.mean().round()) for picture in sight.decode()]


def test_an_episode_becomes_a_recording(root):
    recording = read_droid(root)
    assert recording.views == ("exterior_1_left", "exterior_2_left", "wrist_left")
    assert (recording.rate, recording.path, recording.valid) == (15, root, ())
    assert len(recording.state_names) == len(recording.action_names) == 8
    (episode,) = recording.episodes
    assert (episode.name, episode.instruction, episode.length) == (UUID, "Move a cup", LENGTH)
    joints = np.linspace(0, 1, 7 * LENGTH).reshape(LENGTH, 7)
    t = np.arange(LENGTH)[:, None] / LENGTH
    np.testing.assert_array_equal(episode.state, np.float32(np.hstack([joints, 1 - t])))
    np.testing.assert_array_equal(episode.action, np.float32(np.hstack([joints + 0.5, t])))
    for view, shift in (("wrist_left", 0), ("exterior_1_left", 3), ("exterior_2_left", 6)):
        sight = episode.sights[view]
        assert (sight.height, sight.width) == (HEIGHT, WIDTH)
        first = next(sight.decode())
        assert first.dtype == np.uint8
        assert first.shape == (HEIGHT, WIDTH, 3)
        expected = shades(LENGTH, shift)[:, 0, 0, 0].astype(int)
        assert np.abs(np.array(greys(sight)) - expected).max() <= 2


def test_cameras_stand_where_their_six_numbers_say(root):
    sights = read_droid(root).episodes[0].sights
    for role, view in (("ext1", "exterior_1_left"), ("ext2", "exterior_2_left")):
        placement = sights[view].placement
        np.testing.assert_allclose(placement.base_from_camera, euler(SIX[role]), atol=1e-12)
        assert placement.K is None
    poses = sights["wrist_left"].placement.base_from_camera
    assert poses.shape == (LENGTH, 4, 4)
    np.testing.assert_allclose(poses, wrist_poses(), atol=1e-12)


def test_metadata_says_it_where_steps_do_not(tmp_path):
    none = {f"observation/camera_extrinsics/{s}_left": None for s in SERIALS.values()}
    write_episode(tmp_path / "a", arrays=none)
    sights = read_droid(tmp_path).episodes[0].sights
    ext1 = sights["exterior_1_left"].placement
    np.testing.assert_allclose(ext1.base_from_camera, euler(SIX["ext1"]), atol=1e-12)
    assert ext1.source == "DROID's metadata"
    poses = sights["wrist_left"].placement.base_from_camera  # carried along by the grip
    np.testing.assert_allclose(poses, wrist_poses(), atol=1e-12)


def test_numbers_that_were_never_filled_in_are_none(tmp_path):
    zeros = {
        f"observation/camera_extrinsics/{s}_left": np.zeros((LENGTH, 6)) for s in SERIALS.values()
    }
    folder = write_episode(tmp_path / "a", arrays=zeros)
    content = metadata() | {f"{role}_cam_extrinsics": [0.0] * 6 for role in SERIALS}
    (folder / f"metadata_{UUID}.json").write_text(json.dumps(content))
    assert {s.placement for s in read_droid(tmp_path).episodes[0].sights.values()} == {None}


def test_later_annotations_come_first(tmp_path):
    write_episode(tmp_path / "a")
    better = [0.31, 0.52, 0.41, -2.05, 0.12, -1.25]
    for name, content in {
        "cam2base_extrinsics.json": {UUID: {"20": better, "relative_path": "a", "quality": 0.9}},
        "intrinsics.json": {UUID: {serial: [20 * k for k in K] for serial in SERIALS.values()}},
        "droid_language_annotations.json": {UUID: {"language_instruction1": "Lift the cup"}},
    }.items():
        (tmp_path / name).write_text(json.dumps(content))
    recording = calibrated(read_droid(tmp_path))
    require_calibrated(recording, "late")
    (episode,) = recording.episodes
    assert episode.instruction == "Lift the cup"
    ext1 = episode.sights["exterior_1_left"].calibration
    np.testing.assert_allclose(ext1.base_from_camera, euler(better), atol=1e-12)
    fx, cx, fy, cy = K
    half = 0.5 / 20  # whole numbers are centres in pictures of 1280x720
    expected = [[fx, 0, cx + half], [0, fy, cy + half], [0, 0, 1]]
    np.testing.assert_allclose(ext1.K, expected, atol=1e-12)
    assert ext1.source == "K: DROID's intrinsics.json; pose: DROID's cam2base_extrinsics.json"


def test_k_comes_from_a_file_that_is_given_or_is_missed(root, tmp_path):
    recording = calibrated(read_droid(root))
    with pytest.raises(DatasetError, match=r"exterior_1_left .*K \(its pose: DROID.*--cameras"):
        require_calibrated(recording, "early")
    require_calibrated(recording, "none")
    view = {"K": {"fx": 800, "fy": 800, "cx": 640, "cy": 360}, "size": [1280, 720]}
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps({"format": 1, "views": dict.fromkeys(recording.views, view)}))
    given = calibrated(read_droid(root), path)
    require_calibrated(given, "early")
    wrist = given.episodes[0].sights["wrist_left"].calibration
    np.testing.assert_allclose(wrist.K, [[40, 0, 32], [0, 40, 18], [0, 0, 1]], atol=1e-12)
    assert wrist.base_from_camera.shape == (LENGTH, 4, 4)
    assert wrist.source == f"K: {path}; pose: DROID's extrinsics of each step"
    assert given.action_is == "joint_abs"
    assert given.fingerprint != recording.fingerprint == read_droid(root).fingerprint


def test_steps_without_a_command_are_left_out(tmp_path):
    skipped = np.array([True, False, False, True, False, False])
    write_episode(tmp_path / "a", arrays={"observation/timestamp/skip_action": skipped})
    (episode,) = read_droid(tmp_path).episodes
    assert episode.length == 4
    t = np.array([1, 2, 4, 5])
    np.testing.assert_allclose(episode.action[:, -1], t / LENGTH, rtol=1e-6)
    expected = shades(LENGTH)[t, 0, 0, 0].astype(int)
    assert np.abs(np.array(greys(episode.sights["wrist_left"])) - expected).max() <= 2
    poses = episode.sights["wrist_left"].placement.base_from_camera
    np.testing.assert_allclose(poses, wrist_poses()[t], atol=1e-12)


def test_an_episode_ends_with_its_shortest_video(tmp_path):
    videos = {"ext1": shades(LENGTH - 2), "wrist": shades(LENGTH + 1)}
    write_episode(tmp_path / "a", videos=videos)
    recording = read_droid(tmp_path)
    assert recording.views == ("exterior_1_left", "wrist_left")
    (episode,) = recording.episodes
    assert episode.length == LENGTH - 2
    assert {len(greys(sight)) for sight in episode.sights.values()} == {LENGTH - 2}


def test_other_actions(root):
    recording = read_droid(root, "cartesian_position")
    assert recording.action_names == ("x", "y", "z", "roll", "pitch", "yaw", "gripper")
    assert recording.episodes[0].action.shape == (LENGTH, 7)
    assert recording.fingerprint != read_droid(root).fingerprint
    assert recording.pictures == read_droid(root).pictures != ""


def nothing(folder):
    pass


def failed(folder):
    write_episode(folder / "a", success=False)


def no_videos(folder):
    write_episode(folder / "a", videos={})


def truncated(folder):
    path = write_episode(folder / "a") / "recordings/MP4/20.mp4"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def no_video(folder):
    path = write_episode(folder / "a") / "recordings/MP4/20.mp4"
    path.write_bytes(b"<html>not found</html>")


def short(folder):
    write_episode(folder / "a", length=30, videos={"ext1": shades(5)})


def others(folder):
    (write_episode(folder / "a") / "recordings/MP4").rename(folder / "a" / "recordings" / "x")
    (folder / "a/recordings/MP4").mkdir()
    (folder / "a/recordings/x/20.mp4").rename(folder / "a/recordings/MP4/99.mp4")


def nan(folder):
    state = np.full((LENGTH, 7), np.nan)
    write_episode(folder / "a", arrays={"observation/robot_state/joint_positions": state})


def too_large(folder):
    state = np.full((LENGTH, 7), 1e300)
    write_episode(folder / "a", arrays={"observation/robot_state/joint_positions": state})


def flags(folder):
    write_episode(folder / "a", arrays={"observation/timestamp/skip_action": np.zeros(3, bool)})


def six_joints(folder):
    write_episode(folder / "a", arrays={"action/joint_position": np.zeros((LENGTH, 6))})


def no_actions(folder):
    write_episode(folder / "a", arrays={"action/joint_position": None})


def cut(folder):
    path = write_episode(folder / "a") / "trajectory.h5"
    path.write_bytes(path.read_bytes()[:3000])


def extrinsics(numbers):
    def make(folder):
        array = np.tile(np.array(numbers), (LENGTH, 1))
        write_episode(folder / "a", arrays={"observation/camera_extrinsics/20_left": array})

    return make


BAD = {
    "nothing": (nothing, DatasetError, "no episode of DROID's"),
    "failures": (failed, DatasetError, "1 failures and 0 episodes without videos"),
    "no videos": (no_videos, DatasetError, "0 failures and 1 episodes without videos"),
    "a truncated video": (truncated, DatasetError, r"20\.mp4: truncated"),
    "a page for a video": (no_video, DatasetError, r"20\.mp4: no MP4 with a video"),
    "a short video": (short, DatasetError, r"20\.mp4: 5 pictures, expected 30"),
    "videos of others": (others, DatasetError, "its cameras are .*20.*but the videos are of 99"),
    "NaN": (nan, DatasetError, "NaN or infinity in the state of step 0"),
    "too large numbers": (too_large, DatasetError, "infinity in the state of step 0"),
    "flags of three steps": (flags, DatasetError, "skip_action: 3 steps, expected 6"),
    "six joints": (six_joints, DatasetError, r"action of shapes \[6, 6\]"),
    "no actions": (no_actions, DatasetError, "no 'joint_position'"),
    "a cut file": (cut, DatasetError, r"trajectory\.h5: damaged or truncated"),
    "degrees": (extrinsics((0.3, 0.5, 0.4, -115, 5, -69)), CameraError, "in degrees"),
    "NaN in extrinsics": (extrinsics((np.nan, 0, 0, 1, 1, 1)), CameraError, "finite numbers"),
    "five numbers": (extrinsics((0.3, 0.5, 0.4, -2, 1)), CameraError, "six numbers"),
}


@pytest.mark.parametrize("what", BAD)
def test_what_cannot_be_learned_from_is_refused(tmp_path, what):
    make, error, words = BAD[what]
    make(tmp_path)
    with pytest.raises(error, match=words):
        read_droid(tmp_path)


def test_a_video_that_is_damaged_later_is_named(root, tmp_path):
    folder = write_episode(tmp_path / "a")
    (episode,) = read_droid(tmp_path).episodes
    path = folder / "recordings/MP4/20.mp4"
    path.unlink()
    with pytest.raises(DatasetError, match="cannot be decoded after 0 pictures") as error:
        list(episode.sights["exterior_1_left"].decode())
    assert f"20.mp4, episode '{UUID}'" in str(error.value)


@pytest.mark.parametrize("text", ["", "[]", '{"success": "yes"}', '{"ext1_cam_extrinsics": "x"}'])
def test_damaged_metadata(tmp_path, text):
    folder = write_episode(tmp_path / "a")
    (folder / f"metadata_{UUID}.json").write_text(text)
    with pytest.raises((ConfigError, DatasetError), match="metadata_"):
        read_droid(tmp_path)


@pytest.mark.parametrize("name", ["intrinsics.json", "cam2base_extrinsics.json"])
@pytest.mark.parametrize("value", [[], {UUID: {"20": "x"}}, {UUID: {"20": [1, 2]}}])
def test_damaged_annotations(tmp_path, name, value):
    write_episode(tmp_path / "a")
    (tmp_path / name).write_text(json.dumps(value))
    with pytest.raises(JaxcamError, match=name):
        read_droid(tmp_path)


def test_metadata_may_be_missing(root, tmp_path):
    folder = write_episode(tmp_path / "a")
    (folder / f"metadata_{UUID}.json").unlink()
    (episode,) = read_droid(tmp_path).episodes
    assert (episode.name, episode.instruction) == ("a", "")
    assert set(episode.sights) == set(read_droid(root).views)
    np.testing.assert_allclose(
        episode.sights["exterior_1_left"].placement.base_from_camera, euler(SIX["ext1"]), atol=1e-12
    )


def test_folders_are_recognised(root, tmp_path):
    assert recognise(root) == recognise(root / DAY) == "droid"
    assert is_droid(root)
    assert not is_droid(tmp_path)
    assert recognise(tmp_path) == "unknown"
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "info.json").write_text("{}")
    assert recognise(tmp_path) == "lerobot"
