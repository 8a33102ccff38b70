"""Poses of the grip, from the state of a recorded dataset."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from jaxcam.config.calibrate import RotationForm
from jaxcam.data.recorded.parts import meaning_of
from jaxcam.data.recorded.recording import Recording
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.rays.rotations import matrix_from_quaternion
from jaxcam.robot.calibration.projection import pose_of

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


def grip_numbers(recording: Recording, text: str, form: RotationForm) -> GripNumbers:
    """Which columns are the grip's pose, by a setting or by their names.

    Args:
        recording: The dataset.
        text: Such as "observation.state[0:6]"; by names when empty.
        form: How the rotation is written.

    Raises:
        ConfigError: Neither says, or the setting names other numbers of columns than the form has.
    """
    names = recording.state_names
    if not text:
        return _by_names(recording, form)
    match = re.fullmatch(r"(?:observation\.)?state\[([0-9]{1,6}):([0-9]{1,6})\]", text.strip())
    first, last = (int(match[1]), int(match[2])) if match else (0, 0)
    if not match or last > len(names) or last - first not in (6, 7):
        raise ConfigError(
            f"--grip-pose names six columns of the state (position, rotation vector or Euler "
            f"angles) or seven (position, quaternion) as observation.state[0:6] does, of "
            f"{len(names)} that there are ({', '.join(names)}); got {text[:80]!r}."
        )
    if form == "by_names":
        named = _form_of(names[first + 3 : last])
        if named is None:
            fitting = [name for name, count in COUNTS.items() if count == last - first - 3]
            raise ConfigError(
                f"--grip-pose {text}: the names ({', '.join(names[first + 3 : last])}) do not say "
                f"how the rotation is written. Give --rotation: {', '.join(fitting)}."
            )
        form, order = named
        columns = tuple(first + 3 + i for i in order)
        return GripNumbers(tuple(range(first, first + 3)), columns, form)
    if COUNTS[form] != last - first - 3:
        raise ConfigError(
            f"--rotation {form} has {COUNTS[form]} numbers, --grip-pose {text} leaves "
            f"{last - first - 3} after the position."
        )
    return GripNumbers(tuple(range(first, first + 3)), tuple(range(first + 3, last)), form)


def _by_names(recording: Recording, form: RotationForm) -> GripNumbers:
    position = meaning_of(recording).grip
    named = _form_of(recording.state_names)
    if position is None or named is None:
        raise ConfigError(
            f"The names of the state ({', '.join(recording.state_names)}) do not say where the "
            f"grip's {'position' if position is None else 'rotation'} is. Give --grip-pose, for "
            "example --grip-pose observation.state[0:6] --rotation rotvec."
        )
    if form not in ("by_names", named[0]):
        if COUNTS[form] != len(named[1]) or {form, named[0]} <= {"quaternion_wxyz"}:
            raise ConfigError(f"--rotation {form}: the names of the state say {named[0]}.")
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
    return pose_of(_rotations(values, columns.form, where), position)


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
