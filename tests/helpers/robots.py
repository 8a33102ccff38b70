"""Recorded datasets of robots that never were: numbers and pictures from a seed."""

from pathlib import Path

import numpy as np

from jaxcam.data.recorded.recording import Calibration, Episode, Recording, Sight
from jaxcam.rays import look_at
from jaxcam.rays.lens import pack

SIZES = {"front": (48, 64), "side": (60, 60), "wrist": (48, 80)}
"""Rows and columns of the pictures of each view."""


def recording(folder, *, episodes=4, actions=5, views=("front", "side"), moving=(), lens=True):
    """A recorded dataset whose grip wanders, and whose cameras look at it."""
    rng = np.random.default_rng(0)
    made = []
    for number in range(episodes):
        length = 10 + number
        path = np.cumsum(rng.normal(0, 0.01, (length, 3)), 0) + np.array([0.4, 0, 0.2])
        state = np.concatenate([path, rng.normal(size=(length, 2))], 1).astype(np.float32)
        action = rng.normal(size=(length, actions)).astype(np.float32)
        sights = {view: _sight(number, view, length, view in moving, lens) for view in views}
        made.append(Episode(str(number), state, action, "Stack the cups.", sights))
    state_names = ("ee_x", "ee_y", "ee_z", "wrist", "gripper")
    names = (*(f"joint_{i}" for i in range(actions - 1)), "gripper")
    return Recording(Path(folder), tuple(views), state_names, names, 10.0, made, "fingerprint")


def _sight(episode, view, length, moves, lens):
    rows, columns = SIZES[view]
    angle = 0.3 * list(SIZES).index(view) + 0.05 * episode
    eye = np.array([0.4 + np.cos(angle), np.sin(angle), 0.7])
    pose = np.asarray(look_at(eye, np.array([0.4, 0, 0.2])))
    poses = np.tile(pose, (length, 1, 1))
    poses[:, 0, 3] += 0.01 * np.arange(length)
    K = np.array([[columns * 1.1, 0, columns / 2], [0, columns * 1.1, rows / 2], [0, 0, 1]])
    distortion = pack(np.array([-0.2, 0.05, 0, 0])) if lens and view == "front" else np.zeros(9)

    def decode():
        for t in range(length):
            yield picture(episode, view, t)

    calibration = Calibration(K, poses if moves else pose, np.asarray(distortion), "a test")
    return Sight(rows, columns, decode, calibration)


def picture(episode, view, t):
    """The picture of a view at a step: smooth colours that tell which it is."""
    rows, columns = SIZES[view]
    y, x = np.mgrid[:rows, :columns]
    shades = [3 * y % 256, 3 * x % 256, np.full_like(x, 20 * t + 3 * episode)]
    return np.stack(shades, -1).astype(np.uint8)
