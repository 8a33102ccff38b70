"""Calibrations of cameras that the hand carries, and of those of which only half is known."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from recorded import HEIGHT, WIDTH, recording

from jaxcam.errors import ConfigError
from jaxcam.interop.calibrations import calibrated
from jaxcam.rays import look_at

POSE = np.asarray(look_at(np.array([0.9, 0.2, 0.5]), np.array([0.4, 0.0, 0.1])), np.float64)
K = np.array([[60.0, 0, 30.5], [0, 61.0, 25.0], [0, 0, 1]])
WIDE = [-0.2, 0.05, 0.001, -0.0005, 0.01]
FRONT = {"K": K.tolist(), "size": [WIDTH, HEIGHT], "lens": "opencv", "distortion": WIDE}


def write(folder, content, name="cameras.json"):
    path = folder / name
    path.write_text(json.dumps(content))
    return path


def test_a_camera_on_the_hand_moves_with_it(tmp_path):
    before = replace(recording(), state_names=("ee_x", "ee_y", "ee_z", "ee_rx", "ee_ry", "ee_rz"))
    rng = np.random.default_rng(0)
    episodes = [
        replace(e, state=rng.uniform(-1, 1, (e.length, 6)).astype(np.float32))
        for e in before.episodes
    ]
    before = replace(before, episodes=episodes)
    on_hand = [*POSE[:3].tolist(), [0, 0, 0, 1]]
    hand = {"K": K.tolist(), "size": [WIDTH, HEIGHT], "grip_from_camera": on_hand}
    late = hand | {"grip": {"delay_ms": 1000 / before.rate}}
    path = write(tmp_path, {"format": 1, "views": {"wrist": hand},
                            "episodes": {"1": {"wrist": late}}})  # fmt: skip
    result = calibrated(before, path)
    for number in (0, 1):
        state = episodes[number].state.astype(float)
        got = result.episodes[number].sights["wrist"].calibration.base_from_camera
        for t in range(len(state) - 1):
            grip = np.eye(4)
            place = state[t + number]
            grip[:3, :3], grip[:3, 3] = cv2.Rodrigues(place[3:])[0], place[:3]
            np.testing.assert_allclose(got[t], grip @ POSE, atol=1e-6)
    unnamed = replace(before, state_names=tuple("abcdef"))
    with pytest.raises(ConfigError, match=r"do not say where the grip's position is.*grip: pose"):
        calibrated(unnamed, path)


def test_the_lens_of_half_a_calibration_is_kept(tmp_path):
    path = write(tmp_path, {"format": 1, "views": {"front": FRONT}})
    half = calibrated(recording(), path)
    pose = {"format": 1, "views": {"front": {"base_from_camera": POSE.tolist()}}}
    whole = calibrated(half, write(tmp_path, pose, "poses.json"))
    camera = whole.episodes[0].sights["front"].calibration
    np.testing.assert_array_equal(camera.K, K)
    np.testing.assert_array_equal(camera.distortion[:5], WIDE)
