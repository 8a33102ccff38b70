"""A recorded dataset whose pictures show what its cameras would see: a room, and a moving hand."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from jaxcam.data.recorded.recording import Calibration, Episode, Recording, Sight
from jaxcam.rays import Camera, look_at
from jaxcam.rays.lens import pack

SIZE = (72, 96)
"""Rows and columns of the pictures."""
EYES = {"front": (1.3, 0.2, 0.7), "left": (0.6, 1.0, 0.6), "right": (0.7, -0.9, 0.75)}
"""Where the cameras stand (m, base frame)."""
AIM = np.array([0.4, 0.0, 0.15])
"""What they look at."""
STATE = ("ee_x", "ee_y", "ee_z", "wrist", "gripper")


def calibrations(lens=None):
    """Where each camera stands, and how it sees."""
    height, width = SIZE
    K = np.array([[110.0, 0, width / 2], [0, 110.0, height / 2], [0, 0, 1]])
    lens = np.zeros(9) if lens is None else np.asarray(pack(np.array(lens)))
    poses = {view: np.asarray(look_at(np.array(eye), AIM), float) for view, eye in EYES.items()}
    return {view: Calibration(K, pose, lens, "a test") for view, pose in poses.items()}


def filmed(episodes=5, length=16, views=tuple(EYES), lens=None):
    """A good dataset. Change it with `replace`, `with_sights` and `with_pictures`."""
    cameras, made = calibrations(lens), []
    for number in range(episodes):
        rng = np.random.default_rng(number)
        path = AIM + np.cumsum(rng.normal(0, 0.03, (length, 3)), 0) * [1, 1, 0.5]
        state = np.concatenate([path, rng.normal(size=(length, 2))], 1).astype(np.float32)
        action = rng.normal(size=(length, 4)).astype(np.float32)
        sights = {}
        for view in views:
            pictures = film(view, cameras[view], state[:, :3])
            sights[view] = sight(pictures, cameras[view])
        made.append(Episode(f"e{number}", state, action, "Reach.", sights))
    names = ("joint_0", "joint_1", "joint_2", "gripper")
    return Recording(Path("cups"), tuple(views), STATE, names, 5.0, made, "fingerprint")


def sight(pictures, calibration):
    """A view whose pictures are in memory."""
    height, width = pictures.shape[1:3]
    return Sight(height, width, lambda: iter(pictures), calibration)


def film(view, calibration, path):
    """Pictures of a hand that goes along a path (base frame, m) before the room of a view."""
    height, width = SIZE
    pixels, _ = Camera(
        calibration.K, calibration.base_from_camera, height, width, calibration.distortion
    ).project(path.astype(float))
    pictures = np.tile(room(view), (len(path), 1, 1, 1))
    for picture, (u, v) in zip(pictures, pixels, strict=True):
        cv2.circle(picture, (round(u - 0.5), round(v - 0.5)), 5, (250, 240, 230), -1)
    return pictures


def room(view):
    """What a view sees that never moves."""
    rng = np.random.default_rng(list(EYES).index(view))
    noise = rng.uniform(0, 255, (*SIZE, 3)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.5)
    return np.clip((smooth - smooth.mean()) * 4 + 90, 0, 200).astype(np.uint8)


def with_sights(recording, change):
    """The dataset with each sight as `change(episode, view, sight)` has it."""
    episodes = [
        replace(e, sights={view: change(i, view, s) for view, s in e.sights.items()})
        for i, e in enumerate(recording.episodes)
    ]
    return replace(recording, episodes=episodes)


def with_calibrations(recording, change):
    """The dataset with each calibration as `change(episode, view, calibration)` has it."""
    return with_sights(
        recording, lambda i, view, s: replace(s, calibration=change(i, view, s.calibration))
    )


def with_pictures(recording, change):
    """The dataset with the pictures that `change(episode, view, pictures)` gives."""

    def changed(i, view, one):
        pictures = np.stack(list(one.decode()))
        return sight(change(i, view, pictures), one.calibration)

    return with_sights(recording, changed)


def with_state(recording, episode, step, column, value):
    """The dataset with one number of its state changed."""
    state = recording.episodes[episode].state.copy()
    state[step, column] = value
    episodes = list(recording.episodes)
    episodes[episode] = replace(episodes[episode], state=state)
    return replace(recording, episodes=episodes)


def turned(pictures, K, rotation):
    """What a camera sees after it was turned, as far as it saw it before."""
    warp = K @ rotation.T @ np.linalg.inv(K)
    size = pictures.shape[2], pictures.shape[1]
    border = cv2.BORDER_REFLECT
    return np.stack([cv2.warpPerspective(p, warp, size, borderMode=border) for p in pictures])


def about(findings, what, mark="bad"):
    """Findings of a mark about one thing."""
    return [f for f in findings if f.what == what and f.mark == mark]
