"""Which cameras of a dataset cannot have seen its demonstrations, and what their poses may mean.

A camera pose is sixteen numbers that mean nothing without their convention. Demonstrations tell
whether the convention is ours: the grip, whose places are recorded, must be before the camera, in
its picture and within reach, and the picture's top must be up. Where too many cameras fail, the
poses are read in the ways that other software writes them, and the reading that passes is named.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from jaxcam.console.words import some
from jaxcam.data.demos import Demos
from jaxcam.errors import CameraError
from jaxcam.rays import check_pose, invert, opencv_from_opengl
from jaxcam.rays.lens import distort
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
EXPECTED = (
    "the grip before the camera, in its picture and "
    f"{REACH[0]:g} to {REACH[1]:g} m away, the picture's top up"
)
"""What a camera must be like, in words."""

Fault = Literal[
    "behind the camera", "outside the picture", "too far away or too near", "upside down"
]
"""Why a camera cannot have seen the grip; the first three say where the grip is."""


@dataclass(frozen=True)
class Sights:
    """Cameras that are used, and what they should have seen."""

    rows: np.ndarray
    """Rows of the file's cameras [C]."""
    poses: np.ndarray
    """Their poses [C, 4, 4], OpenCV axes, in the frame of the points."""
    points: np.ndarray
    """Places of the grip [C, P, 3] (m)."""
    K: np.ndarray
    """Intrinsics in pixels [C, 3, 3]."""
    sizes: np.ndarray
    """Rows and columns of their pictures [C, 2]."""
    lenses: np.ndarray | None = None
    """As `jaxcam.rays.lens.pack` gives them [C, 9]; None is pinholes."""
    carried: bool = False
    """Whether the robot carries them: those may be near what they see, and turned any way."""


@dataclass(frozen=True)
class Reading:
    """One of the ways in which other software writes camera poses."""

    words: str
    """What was done, and what to do about it."""
    convert: Callable[[np.ndarray, np.ndarray], np.ndarray]
    """Poses [C, 4, 4] as they should have been, from those written and `world_from_base` [4, 4]."""


@dataclass(frozen=True)
class CameraFaults:
    """What is wrong with the cameras of a dataset."""

    rows: np.ndarray
    """Rows of the file's cameras that were looked at [C]."""
    by_fault: Mapping[Fault, np.ndarray]
    """Which of them have a fault, bool [C] each."""
    cause: Reading | None
    """The reading that explains most of them, if so many are odd that there must be one."""

    @property
    def odd(self) -> np.ndarray:
        """Which cameras have any fault, bool [C]."""
        return np.any(list(self.by_fault.values()), 0)

    @property
    def tolerable(self) -> bool:
        """Whether those are so few that it is not the convention that is wrong."""
        return bool(self.odd.mean() <= TOLERATED)

    @property
    def summary(self) -> str:
        """How many cameras are odd, and why."""
        count = ", ".join(
            f"{fault} {mask.sum()}" for fault, mask in self.by_fault.items() if mask.any()
        )
        return f"{self.odd.sum()} of {len(self.rows)} cameras are odd: {count}"

    @property
    def where(self) -> str:
        """The first rows of odd cameras."""
        return some(self.rows[self.odd].tolist())

    @property
    def remedy(self) -> str:
        """What to do."""
        if self.tolerable:
            return "Look at the pictures of those."
        if self.cause:
            return f"Likely cause: {self.cause.words}."
        return "No usual mix-up of conventions explains it: look at the pictures."


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


READINGS = (
    Reading(
        "the matrices map world to camera; store their inverses (jaxcam.rays.invert)",
        lambda poses, base: invert(poses),
    ),
    Reading(
        "the axes are OpenGL's (y up, z backwards); store opencv_from_opengl(poses) of jaxcam.rays",
        lambda poses, base: opencv_from_opengl(poses),
    ),
    Reading(
        "the matrices map world to camera in OpenGL's axes; "
        "store opencv_from_opengl(invert(poses))",
        lambda poses, base: opencv_from_opengl(invert(poses)),
    ),
    Reading(
        "the rotations are transposed (columns read as rows)",
        lambda poses, base: _with_rotation(poses, poses[:, :3, :3].swapaxes(-1, -2)),
    ),
    Reading(
        "the rotations were made from quaternions xyzw read as wxyz",
        lambda poses, base: _rolled_quaternion(poses, 1),
    ),
    Reading(
        "the rotations were made from quaternions wxyz read as xyzw",
        lambda poses, base: _rolled_quaternion(poses, -1),
    ),
    Reading(
        "positions are in millimetres; divide them by 1000",
        lambda poses, base: _scaled(poses, 0.001),
    ),
    Reading(
        "positions are in centimetres; divide them by 100", lambda poses, base: _scaled(poses, 0.01)
    ),
    Reading(
        "the poses are in the robot's base frame; store world_from_base @ poses",
        lambda poses, base: base @ poses,
    ),
)
"""How else poses may have been written."""


OWN_OPTICS = Reading(
    "their own intrinsics and lenses (cameras/K, cameras/distortion): with the task's the grip is "
    "in the pictures. Draw them from ranges of wider fields of view and smaller offsets, or "
    "correct them",
    lambda poses, base: poses,
)
"""Why cameras do not see what they should whose poses are right."""


def sights_of(demos: Demos) -> Sights:
    """The cameras that demonstrations are seen by, each with places of the grip in those."""
    paths: dict[int, list[np.ndarray]] = {}
    for demo in demos.episodes:
        for row in demo.cameras:
            paths.setdefault(int(row), []).append(demo.eef_pos)
    rows = np.array(sorted(paths))
    points = []
    for row in rows:
        places = np.concatenate(paths[int(row)])
        points.append(places[np.linspace(0, len(places) - 1, POINTS).astype(int)])
    poses = np.asarray(demos.header.world_from_camera[rows], np.float64)
    header, count = demos.header, len(rows)
    with np.errstate(divide="ignore"):  # a field of view that cannot be sees nothing
        f = 1 / np.tan(np.deg2rad(header.fovy_deg) / 2)
    K = np.tile(np.array([[f, 0, 1], [0, f, 1], [0, 0, 1]]), (count, 1, 1))
    if header.K is not None:
        K = header.intrinsics(2)[rows]
    lenses = None if header.distortion is None else header.distortion[rows]
    return Sights(rows, poses, np.stack(points), K, np.full((count, 2), 2.0), lenses)


def faults(sights: Sights) -> dict[Fault, np.ndarray]:
    """Which cameras cannot have seen what they should, bool [C] by the reason."""
    rotation, position = sights.poses[:, :3, :3], sights.poses[:, None, :3, 3]
    local = (sights.points - position) @ rotation
    distance = np.linalg.norm(np.median(sights.points - position, 1), axis=-1)
    behind = np.median(local[..., 2], -1) <= 0
    nearest = 0 if sights.carried else REACH[0]
    return {
        "behind the camera": behind,
        "outside the picture": ~behind & (_inside(sights, local).mean(-1) < IN_VIEW),
        "too far away or too near": (distance < nearest) | (distance > REACH[1]),
        "upside down": (rotation[:, 2, 1] > LEVEL) & (not sights.carried),
    }


def _inside(sights: Sights, local: np.ndarray) -> np.ndarray:
    """Which points [C, P, 3] in the axes of their cameras are in the pictures, bool [C, P]."""
    inside = local[..., 2] > 0
    with np.errstate(all="ignore"):  # what is not in front of a camera, or whose K is no number
        x, y = np.moveaxis(local[..., :2] / local[..., 2:], -1, 0)
        if sights.lenses is not None:
            x, y, in_field = distort(x, y, sights.lenses[:, None], "opencv")
            inside &= in_field
        K, sizes = sights.K[:, None], sights.sizes[:, None]
        u = K[..., 0, 0] * x + K[..., 0, 1] * y + K[..., 0, 2]
        v = K[..., 1, 1] * y + K[..., 1, 2]
        return inside & (u >= 0) & (u <= sizes[..., 1]) & (v >= 0) & (v <= sizes[..., 0])


def readings_that_fit(sights: Sights, world_from_base: np.ndarray) -> list[Reading]:
    """The readings of the poses under which few cameras are odd, the best first.

    Args:
        sights: Cameras, and what they should have seen.
        world_from_base: The robot's base in the frame of the points [4, 4].
    """
    shares = []
    for reading in READINGS:
        poses = reading.convert(sights.poses, world_from_base)
        shares.append(np.any(list(faults(replace(sights, poses=poses)).values()), 0).mean())
    order = np.argsort(shares, kind="stable")
    return [READINGS[i] for i in order if shares[i] <= TOLERATED]


def camera_faults(demos: Demos) -> CameraFaults:
    """What is wrong with the cameras of a dataset, whose poses are rigid."""
    sights = sights_of(demos)
    result = CameraFaults(sights.rows, faults(sights), None)
    if result.tolerable:
        return result
    if demos.header.K is not None:
        usual = sights_of(replace(demos, header=replace(demos.header, K=None, distortion=None)))
        if np.any(list(faults(usual).values()), 0).mean() <= TOLERATED:
            return replace(result, cause=OWN_OPTICS)
    base = make_task(demos.header.task).scene(demos.header.scene).world_from_base
    return replace(result, cause=next(iter(readings_that_fit(sights, base)), None))


def require_rigid(demos: Demos) -> None:
    """Refuses a dataset whose camera poses are not rigid transforms.

    Raises:
        CameraError: Naming the first such camera, and why it is none.
    """
    check_pose("cameras/world_from_camera", demos.header.world_from_camera)


def require_possible(demos: Demos) -> None:
    """Refuses a dataset whose cameras cannot have seen its demonstrations.

    Raises:
        CameraError: Naming cameras, what was expected, what was got, and the likely cause.
    """
    look = f"See: python -m jaxcam.check {demos.path}"
    try:
        require_rigid(demos)
    except CameraError as error:
        raise CameraError(f"{demos.path}: {error} {look}") from error
    result = camera_faults(demos)
    if not result.tolerable:
        raise CameraError(
            f"{demos.path}: cameras {result.where}: {result.summary}. Expected {EXPECTED}. "
            f"{result.remedy} {look}"
        )
