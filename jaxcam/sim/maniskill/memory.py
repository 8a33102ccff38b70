"""Memory that a child process and its parent share: states, cameras, targets and pictures."""

import mmap
import os
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

ROWS = 2048
"""Worlds, or views, of one request at most."""
NEAR, FAR = 0.01, 100.0
"""Clipping distances (m) of cameras, ManiSkill's."""
PIXELS = 2**25
"""Bytes for the pictures of one request."""
JOINTS = 9
"""Joints of the robot: arm, then fingers."""


class Sizes(NamedTuple):
    """What the size of the memory follows from."""

    nq: int
    nv: int
    fixtures: int


@dataclass(frozen=True)
class Memory:
    """Arrays in shared memory; the parent writes what is asked, the child what came of it."""

    beat: np.ndarray
    """[1] Counts what the child has done: a child that no longer counts has stopped working."""
    qpos: np.ndarray
    """Asked [ROWS, nq]."""
    qvel: np.ndarray
    """Asked [ROWS, nv]."""
    targets: np.ndarray
    """Asked joint targets (rad, m) [ROWS, 9]."""
    fixtures: np.ndarray
    """Asked poses of what is only seen [ROWS, fixtures, 7]."""
    K: np.ndarray
    """Asked intrinsics [ROWS, 3, 3]."""
    camera: np.ndarray
    """Asked camera poses, OpenCV axes [ROWS, 4, 4]."""
    qpos_now: np.ndarray
    """Reached [ROWS, nq]."""
    qvel_now: np.ndarray
    """Reached [ROWS, nv]."""
    grip: np.ndarray
    """Reached pose (xyz, wxyz) of the grip in the world [ROWS, 7]."""
    pixels: np.ndarray
    """Bytes of the pictures [PIXELS]."""

    def layers(self, count: int, height: int, width: int) -> tuple[np.ndarray, ...]:
        """Pictures uint8 [n, H, W, 3], depths float32 and segments int32 [n, H, W] in `pixels`."""
        area = count * height * width
        rgb = self.pixels[: 3 * area].reshape(count, height, width, 3)
        depth = np.frombuffer(self.pixels, np.float32, area, 3 * area)
        segments = np.frombuffer(self.pixels, np.int32, area, 7 * area)
        return rgb, *(x.reshape(count, height, width) for x in (depth, segments))


def open_memory(file: int, sizes: Sizes) -> Memory:
    """The memory behind a file descriptor, which is made large enough."""
    shapes = {
        "beat": ((1,), np.int64),
        "qpos": ((ROWS, sizes.nq), float),
        "qvel": ((ROWS, sizes.nv), float),
        "targets": ((ROWS, JOINTS), float),
        "fixtures": ((ROWS, sizes.fixtures, 7), float),
        "K": ((ROWS, 3, 3), float),
        "camera": ((ROWS, 4, 4), float),
        "qpos_now": ((ROWS, sizes.nq), float),
        "qvel_now": ((ROWS, sizes.nv), float),
        "grip": ((ROWS, 7), float),
        "pixels": ((PIXELS,), np.uint8),
    }
    total = sum(int(np.prod(shape)) * np.dtype(kind).itemsize for shape, kind in shapes.values())
    if os.fstat(file).st_size < total:
        os.ftruncate(file, total)
    buffer = mmap.mmap(file, total)
    arrays, offset = {}, 0
    for name, (shape, kind) in shapes.items():
        count = int(np.prod(shape))
        arrays[name] = np.frombuffer(buffer, kind, count, offset).reshape(shape)
        offset += count * np.dtype(kind).itemsize
    return Memory(**arrays)
