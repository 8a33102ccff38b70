"""DROID's six numbers: what pose they are, and the columns that LeRobot's form of DROID has."""

import json

import numpy as np
import pytest
from droid_files import SIX, euler, shades, six_of, wrist_poses

from jaxcam.errors import CameraError
from jaxcam.interop.calibrations import calibrated, sources
from jaxcam.interop.cameras.six_numbers import placement_of, poses_of
from jaxcam.interop.lerobot.format import Writer, feature, video_feature
from jaxcam.interop.lerobot.reading import read_lerobot

VIEWS = ("exterior_1_left", "exterior_2_left", "wrist_left")


def test_they_are_a_translation_and_angles_about_fixed_axes():
    for six in SIX.values():
        np.testing.assert_allclose(poses_of(np.array(six), "a"), euler(six), atol=1e-12)
    stacked = np.array(list(SIX.values()))
    np.testing.assert_allclose(
        poses_of(stacked[None], "a")[0], [euler(six) for six in stacked], atol=1e-12
    )


def test_what_stands_still_is_one_pose():
    six = np.tile(np.float32(SIX["ext1"]), (4, 1))
    assert placement_of(six, "a", "b").base_from_camera.shape == (4, 4)
    six[2, 0] += 0.001
    assert placement_of(six, "a", "b").base_from_camera.shape == (4, 4, 4)
    assert placement_of(np.zeros((4, 6)), "a", "b") is None
    with pytest.raises(CameraError, match="an angle of 90; expected radians"):
        placement_of(np.array([0.1, 0, 0, 90, 0, 0]), "a", "b")


def test_columns_of_lerobot(tmp_path):
    """K from a file, the pose from columns; those that were never filled in are none."""
    root, side = tmp_path / "droid", 64
    features = {"observation.state": feature("float32", (2,)), "action": feature("float32", (2,))}
    for view in VIEWS:
        features[f"observation.images.{view}"] = video_feature(side, side, 15)
        features[f"camera_extrinsics.{view}"] = feature("float32", (6,))
    with Writer(root, features, 15, "move it") as writer:
        for length in (4, 5):
            wrist = [six_of(pose) for pose in wrist_poses(length)]
            each = (np.tile(SIX["ext1"], (length, 1)), np.zeros((length, 6)), np.stack(wrist))
            rows = {
                f"camera_extrinsics.{v}": np.float32(e) for v, e in zip(VIEWS, each, strict=True)
            }
            numbers = np.ones((length, 2), np.float32)
            rows |= {"observation.state": numbers, "action": numbers}
            pictures = np.resize(shades(length)[:, :1, :1], (length, side, side, 3))
            writer.add(rows, {f"observation.images.{view}": pictures for view in VIEWS})
        writer.finish("panda")
    path = tmp_path / "cameras.json"
    optics = {"K": {"fx": 800, "fy": 800, "cx": 640, "cy": 640}, "size": [1280, 1280]}
    path.write_text(json.dumps({"format": 1, "views": dict.fromkeys(VIEWS, optics)}))
    recording = calibrated(read_lerobot(root), path)
    assert sources(recording) == [
        f"View exterior_1_left: K: {path}; pose: the column camera_extrinsics.exterior_1_left.",
        f"View exterior_2_left: nobody says its pose (K: {path}).",
        f"View wrist_left: K: {path}; pose: the column camera_extrinsics.wrist_left.",
    ]
    for episode, length in zip(recording.episodes, (4, 5), strict=True):
        front = episode.sights["exterior_1_left"].calibration
        np.testing.assert_allclose(front.base_from_camera, euler(SIX["ext1"]), atol=1e-6)
        np.testing.assert_allclose(front.K, [[40, 0, 32], [0, 40, 32], [0, 0, 1]])
        wrist = episode.sights["wrist_left"].calibration
        np.testing.assert_allclose(wrist.base_from_camera, wrist_poses(length), atol=1e-6)
