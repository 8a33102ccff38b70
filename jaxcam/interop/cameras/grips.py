"""Poses of the grip, from a robot's state: which numbers of it they are, and at which moment."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from jaxcam.config.calibrate import MOST_DELAY, RotationForm
from jaxcam.config.fields import check_least, check_most, check_types
from jaxcam.data.recorded.parts import grip_named
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.rays.rotations import matrix_from_quaternion

COUNTS: Mapping[RotationForm, int] = {
    "rotvec": 3, "quaternion_wxyz": 4, "quaternion_xyzw": 4, "euler_xyz": 3,
    "euler_zyx_intrinsic": 3,
}  # fmt: skip
"""Numbers of each form."""
_NAMES: Sequence[tuple[RotationForm, tuple[str, ...]]] = (
    ("rotvec", (r"r_?x|rotvec_?x|axis_?angle_?x|rot_?x", r"r_?y|rotvec_?y|axis_?angle_?y|rot_?y",
                r"r_?z|rotvec_?z|axis_?angle_?z|rot_?z")),
    ("quaternion_wxyz", (r"q(?:uat)?_?w", r"q(?:uat)?_?x", r"q(?:uat)?_?y", r"q(?:uat)?_?z")),
    ("euler_xyz", ("roll", "pitch", "yaw")),
)  # fmt: skip
"""How the last part of the numbers' names says what they are."""


@dataclass(frozen=True)
class GripNumbers:
    """Which columns of the state are the grip's pose."""

    position: tuple[int, ...]
    rotation: tuple[int, ...]
    form: RotationForm


@dataclass(frozen=True)
class GripEntries:
    """Entries that say which numbers of a state are the grip's pose."""

    pose: str = ""
    """Such as `observation.state[0:6]`: position (m), then rotation; by their names when empty."""
    rotation: RotationForm = "by_names"
    """How its rotation is written."""
    delay_ms: float = 0.0
    """By how much a state is later than its picture: positive where states show what pictures
    showed before."""

    def __post_init__(self) -> None:
        check_types(self, "grip: ")
        check_least(self, -MOST_DELAY, "delay_ms")
        check_most(self, MOST_DELAY, "delay_ms")


def grip_numbers(names: Sequence[str], entries: GripEntries, where: str = "") -> GripNumbers:
    """Which columns are the grip's pose, by a setting or by their names.

    Args:
        names: Of the state's numbers.
        entries: What is said of them.
        where: Who says it, for messages; flags of the command when empty.

    Raises:
        ConfigError: Neither says, or the setting names other numbers of columns than the form has.
    """
    flags = ("--grip-pose", "--rotation") if not where else (f"{where}: pose", f"{where}: rotation")
    text, form = entries.pose, entries.rotation
    if not text:
        return _by_names(names, form, flags)
    match = re.fullmatch(r"(?:observation\.)?state\[([0-9]{1,6}):([0-9]{1,6})\]", text.strip())
    first, last = (int(match[1]), int(match[2])) if match else (0, 0)
    if not match or last > len(names) or last - first not in (6, 7):
        raise ConfigError(
            f"{flags[0]} names six columns of the state (position, rotation vector or Euler "
            f"angles) or seven (position, quaternion) as observation.state[0:6] does, of "
            f"{len(names)} that there are ({', '.join(names)}); got {text[:80]!r}."
        )
    position = tuple(range(first, first + 3))
    if form == "by_names":
        named = _form_of(names[first + 3 : last])
        if named is None:
            fitting = [name for name, count in COUNTS.items() if count == last - first - 3]
            raise ConfigError(
                f"{flags[0]} {text}: the names ({', '.join(names[first + 3 : last])}) do not say "
                f"how the rotation is written. Give {flags[1]}: {', '.join(fitting)}."
            )
        return GripNumbers(position, tuple(first + 3 + i for i in named[1]), named[0])
    if COUNTS[form] != last - first - 3:
        raise ConfigError(
            f"{flags[1]} {form} has {COUNTS[form]} numbers, {flags[0]} {text} leaves "
            f"{last - first - 3} after the position."
        )
    return GripNumbers(position, tuple(range(first + 3, last)), form)


def _by_names(names: Sequence[str], form: RotationForm, flags: tuple[str, str]) -> GripNumbers:
    position, named = grip_named(names), _form_of(names)
    if position is None or named is None:
        raise ConfigError(
            f"The names of the state ({', '.join(names)}) do not say where the grip's "
            f"{'position' if position is None else 'rotation'} is. Give {flags[0]}, for example "
            f"{flags[0]} observation.state[0:6] {flags[1]} rotvec."
        )
    if form not in ("by_names", named[0]):
        if COUNTS[form] != len(named[1]) or {form, named[0]} <= {"quaternion_wxyz"}:
            raise ConfigError(f"{flags[1]} {form}: the names of the state say {named[0]}.")
        return GripNumbers(position, named[1], form)
    return GripNumbers(position, named[1], named[0])


def _form_of(names: Sequence[str]) -> tuple[RotationForm, tuple[int, ...]] | None:
    """The form that names say, and where its numbers are, in its order."""
    for form, patterns in _NAMES:
        places = [
            [i for i, n in enumerate(names) if re.fullmatch(rf"(?:.*[._ ])?(?:{p})", n.lower())]
            for p in patterns
        ]
        if all(len(some) == 1 for some in places):
            return form, tuple(some[0] for some in places)
    return None


def poses_of_grip(numbers: np.ndarray, columns: GripNumbers, where: str) -> np.ndarray:
    """Poses of the grip in the base frame, float64 [T, 4, 4].

    Args:
        numbers: The state, [T, P].
        columns: Which of it is the pose.
        where: Whose it is, for messages.

    Raises:
        DatasetError: The numbers are no rotations, or no metres.
    """
    position = numbers[:, columns.position].astype(float)
    values = numbers[:, columns.rotation].astype(float)
    if not (np.isfinite(position).all() and np.isfinite(values).all()):
        raise DatasetError(f"{where}: numbers of the grip's pose that are not finite.")
    if np.abs(position).max() > 20:
        raise DatasetError(
            f"{where}: a position of {np.abs(position).max():g}; expected metres. Likely cause: "
            "millimetres, or other columns."
        )
    poses = np.tile(np.eye(4), (len(numbers), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = _rotations(values, columns.form, where), position
    return poses


def poses_between(poses: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Poses at moments between those that were recorded; at the ends, the first and the last.

    Args:
        poses: Array [T, 4, 4].
        steps: Moments in steps, [n].

    Returns:
        Float64 [n, 4, 4].
    """
    at = np.clip(steps, 0, len(poses) - 1)
    if len(poses) == 1 or np.array_equal(at, np.rint(at)):
        return poses[at.astype(int)]
    result = np.tile(np.eye(4), (len(at), 1, 1))
    moments = np.arange(len(poses))
    result[:, :3, :3] = Slerp(moments, Rotation.from_matrix(poses[:, :3, :3]))(at).as_matrix()
    result[:, :3, 3] = np.stack([np.interp(at, moments, p) for p in poses[:, :3, 3].T], -1)
    return result


def _rotations(values: np.ndarray, form: RotationForm, where: str) -> np.ndarray:
    if COUNTS[form] == 4:
        length = np.linalg.norm(values, axis=-1, keepdims=True)
        if (np.abs(length - 1) > 0.02).any():
            raise DatasetError(
                f"{where}: a quaternion of length {float(length.flat[0]):.3g}; expected 1. Likely "
                "cause: other columns, or not a quaternion."
            )
        wxyz = values if form == "quaternion_wxyz" else np.roll(values, 1, -1)
        return np.asarray(matrix_from_quaternion(wxyz / length))
    if np.abs(values).max() > 7:
        raise DatasetError(
            f"{where}: an angle of {np.abs(values).max():g}; expected radians. Likely cause: "
            "degrees."
        )
    if form == "rotvec":
        return Rotation.from_rotvec(values).as_matrix()
    return Rotation.from_euler("xyz" if form == "euler_xyz" else "ZYX", values).as_matrix()
