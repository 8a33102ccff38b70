"""Whether cameras can have seen what they are said to have seen, and what else they may mean.

A camera pose is sixteen numbers that mean nothing without their convention. Demonstrations tell
whether the convention is ours: the grip, whose places are recorded, must be before the camera, in
its picture and within reach, and the picture's top must be up. Where too many cameras fail, the
poses are read in the ways that other software writes them, and the reading that passes is named.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxcam.checks.findings import Finding, some
from jaxcam.data.demos import Demos
from jaxcam.errors import CameraError
from jaxcam.rays import check_pose, invert, opencv_from_opengl
from jaxcam.rays.rotations import matrix_from_quaternion, quaternion_from_matrix
from jaxcam.sim import make_task

POINTS = 64
"""Places of the grip that each camera is tried on."""
IN_VIEW = 0.1
"""Least share of them in the picture. Of the paper's cameras, which look up to 0.15 m past the
middle of the table, the worst of our six tasks' datasets has 0.28."""
REACH = (0.2, 5.0)
"""Distances (m) between a camera and what it sees."""
LEVEL = 1e-3
"""How far up a picture's downward axis may point: a camera straight above the table has none."""
TOLERATED = 0.05
"""Share of cameras that may be odd before it is the convention that is."""


class Sights(NamedTuple):
    """Cameras that are used and what they should have seen."""

    rows: np.ndarray
    """Rows of the file's cameras [C]."""
    poses: np.ndarray
    """World from camera [C, 4, 4]."""
    points: np.ndarray
    """Places of the grip in the world [C, POINTS, 3]."""
    fovy: float
    """Vertical field of view (rad); pictures are square."""


Read = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Poses as they would be if they were written otherwise, from poses and world_from_base."""


def _with_rotation(poses: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    poses = poses.copy()
    poses[:, :3, :3] = rotation
    return poses


def _rolled_quaternion(poses: np.ndarray, by: int) -> np.ndarray:
    quaternion = quaternion_from_matrix(poses[:, :3, :3])
    return _with_rotation(poses, matrix_from_quaternion(np.roll(quaternion, by, -1)))


def _scaled(poses: np.ndarray, unit: float) -> np.ndarray:
    poses = poses.copy()
    poses[:, :3, 3] *= unit
    return poses


READINGS: dict[str, Read] = {
    "the matrices map world to camera; store their inverses (jaxcam.rays.invert)": (
        lambda x, base: invert(x)
    ),
    "the axes are OpenGL's (y up, z backwards); store opencv_from_opengl(poses) of jaxcam.rays": (
        lambda x, base: opencv_from_opengl(x)
    ),
    "the matrices map world to camera in OpenGL's axes; store opencv_from_opengl(invert(poses))": (
        lambda x, base: opencv_from_opengl(invert(x))
    ),
    "the rotations are transposed (columns read as rows)": (
        lambda x, base: _with_rotation(x, x[:, :3, :3].swapaxes(-1, -2))
    ),
    "the rotations were made from quaternions xyzw read as wxyz": (
        lambda x, base: _rolled_quaternion(x, 1)
    ),
    "the rotations were made from quaternions wxyz read as xyzw": (
        lambda x, base: _rolled_quaternion(x, -1)
    ),
    "positions are in millimetres; divide them by 1000": lambda x, base: _scaled(x, 1e-3),
    "positions are in centimetres; divide them by 100": lambda x, base: _scaled(x, 1e-2),
    "the poses are in the robot's base frame; store world_from_base @ poses": (
        lambda x, base: base @ x
    ),
}
"""How else poses may have been written, in words that say what to do."""


def sights(demos: Demos) -> Sights:
    """The cameras that demonstrations are seen by, each with places of the grip in those."""
    seen: dict[int, list[np.ndarray]] = {}
    for demo in demos.train + demos.valid:
        for row in demo.cameras:
            seen.setdefault(int(row), []).append(demo.eef_pos)
    rows = np.array(sorted(seen))
    points = []
    for row in rows:
        places = np.concatenate(seen[int(row)])
        points.append(places[np.linspace(0, len(places) - 1, POINTS).astype(int)])
    poses = np.asarray(demos.header.world_from_camera[rows], np.float64)
    return Sights(rows, poses, np.stack(points), float(np.deg2rad(demos.header.fovy_deg)))


def faults(seen: Sights) -> dict[str, np.ndarray]:
    """Which cameras cannot have seen what they should, bool [C] by the reason."""
    rotation, position = seen.poses[:, :3, :3], seen.poses[:, None, :3, 3]
    local = (seen.points - position) @ rotation
    aside, depth = abs(local[..., :2]).max(-1), local[..., 2]
    inside = (depth > 0) & (aside <= np.tan(seen.fovy / 2) * depth)
    distance = np.linalg.norm(np.median(seen.points - position, 1), axis=-1)
    behind = np.median(depth, -1) <= 0
    return {
        "behind the camera": behind,
        "outside the picture": ~behind & (inside.mean(-1) < IN_VIEW),
        "too far away or too near": (distance < REACH[0]) | (distance > REACH[1]),
        "upside down": rotation[:, 2, 1] > LEVEL,
    }


def odd(seen: Sights) -> np.ndarray:
    """Which cameras have any fault, bool [C]."""
    return np.any(list(faults(seen).values()), 0)


def likely_cause(seen: Sights, world_from_base: np.ndarray) -> str:
    """The other reading of the poses under which the cameras are possible; empty if none is."""
    best, least = "", TOLERATED
    for words, read in READINGS.items():
        share = odd(seen._replace(poses=read(seen.poses, world_from_base))).mean()
        if share < least or (share == least and not best):
            best, least = words, share
    return best


def check_poses(demos: Demos) -> Finding:
    """Whether the cameras of a dataset are rigid poses."""
    poses = demos.header.world_from_camera
    try:
        check_pose("cameras/world_from_camera", poses)
    except CameraError as error:
        return Finding("camera poses", "bad", str(error), fix="Write those cameras anew.")
    return Finding("camera poses", "good", f"{len(poses)} rigid transforms")


def check_cameras(demos: Demos) -> Finding:
    """Whether cameras, whose poses are rigid, can have seen the demonstrations."""
    what = "cameras"
    expected = (
        "the grip before the camera, in its picture and "
        f"{REACH[0]:g} to {REACH[1]:g} m away, the picture's top up"
    )
    seen = sights(demos)
    found = faults(seen)
    flagged = np.any(list(found.values()), 0)
    if not flagged.any():
        inside = f"{len(seen.rows)} cameras have the grip in their pictures"
        return Finding(what, "good", inside)
    told = ", ".join(f"{why} {mask.sum()}" for why, mask in found.items() if mask.any())
    got = f"{flagged.sum()} of {len(flagged)} cameras are odd: {told}"
    where = some(seen.rows[flagged].tolist())
    if flagged.mean() <= TOLERATED:
        return Finding(what, "note", got, expected, where, "Look at the pictures of those.")
    base = make_task(demos.header.task).scene(demos.header.scene).world_from_base
    cause = likely_cause(seen, base)
    unknown = "No usual mix-up of conventions explains it: look at the pictures."
    fix = f"Likely cause: {cause}." if cause else unknown
    return Finding(what, "bad", got, expected, where, fix)


def require_possible(demos: Demos) -> None:
    """Refuses a dataset whose cameras cannot have seen its demonstrations.

    Raises:
        CameraError: naming cameras, what was expected, what was got, and the likely cause.
    """
    look = f"See: python -m jaxcam.check {demos.path}"
    poses = check_poses(demos)
    if poses.mark == "bad":
        raise CameraError(f"{demos.path}: {poses.got} {look}")
    found = check_cameras(demos)
    if found.mark == "bad":
        raise CameraError(
            f"{demos.path}: cameras {found.where}: {found.got}. Expected {found.expected}. "
            f"{found.fix} {look}"
        )
