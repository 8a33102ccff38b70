"""A small recording in memory, with pictures of one size and no calibration."""

from pathlib import Path

import numpy as np

from jaxcam.data.recorded.recording import Episode, Recording, Sight

STEPS = (5, 4, 6)
"""Lengths of its episodes."""
HEIGHT, WIDTH = 48, 64


def sight(length, **more):
    def decode():
        yield from np.zeros((length, HEIGHT, WIDTH, 3), np.uint8)

    return Sight(HEIGHT, WIDTH, decode, **more)


def episode(name, length, views=("front", "wrist"), **more):
    zeros = np.zeros((length, 3), np.float32)
    return Episode(name, zeros, zeros, "lift it", {view: sight(length, **more) for view in views})


def recording(path=Path("recorded"), views=("front", "wrist"), **more):
    names = ("a", "b", "c")
    episodes = [episode(f"episode {i}", length, views, **more) for i, length in enumerate(STEPS)]
    return Recording(path, tuple(views), names, names, 10.0, episodes, "0123")
