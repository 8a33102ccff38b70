"""Joint angles and the gripper's opening, from the state of a recorded dataset."""

import re
from dataclasses import dataclass

import numpy as np

from jaxcam.data.recorded.recording import Episode, Recording
from jaxcam.errors import ConfigError, DatasetError

_JOINT = re.compile(r"^(?:.*[._ /])?(?:joint|j|q)[._ ]?(?:pos(?:ition)?s?[._ ]?)?([0-9]{1,2})"
                    r"(?:[._ ]?pos(?:ition)?)?$")  # fmt: skip
_OPENING = re.compile(r"^(?:.*[._ /])?(?:opening|gripper|gripper_position|gripper_pos)$")
LARGEST = 7.0
"""Angles (rad) beyond which they are no radians."""
METRES = 0.08
"""Opening (m) of a gripper whose opening is said in metres."""


@dataclass(frozen=True)
class JointNumbers:
    """Which columns of the state are joint angles, and which is the gripper's opening."""

    angles: tuple[int, ...]
    opening: int | None
    closes: bool = False
    """Whether large numbers mean a closed gripper, as DROID's do."""


def joint_numbers(recording: Recording, joints: str, opening: str) -> JointNumbers:
    """Which columns are joint angles, by settings or by their names.

    Args:
        recording: The dataset.
        joints: Such as "observation.state[0:7]"; by names when empty.
        opening: Such as "observation.state[10]"; by its name when empty.

    Raises:
        ConfigError: Neither says, or a setting names columns that there are not.
    """
    names = [name.lower() for name in recording.state_names]
    if joints:
        columns = _asked("--joints", joints, len(names))
    else:
        by_number = {int(m[1]): i for i, n in enumerate(names) if (m := _JOINT.match(n))}
        columns = tuple(by_number[number] for number in sorted(by_number))
        if not columns:
            raise ConfigError(
                f"The names of the state ({', '.join(recording.state_names)}) do not say where the "
                "joint angles are. Give --joints observation.state[0:7] with their columns."
            )
    if opening:
        return JointNumbers(columns, _asked("--opening", opening, len(names))[0])
    matches = [i for i, n in enumerate(names) if _OPENING.match(n) and i not in columns]
    if len(matches) != 1:
        return JointNumbers(columns, None)
    return JointNumbers(columns, matches[0], closes="gripper" in names[matches[0]])


def _asked(flag: str, text: str, count: int) -> tuple[int, ...]:
    match = re.fullmatch(r"(?:observation\.)?state\[([0-9]{1,6})(?::([0-9]{1,6}))?\]", text.strip())
    if match:
        first, last = int(match[1]), int(match[2] or int(match[1]) + 1)
        if first < last <= count:
            return tuple(range(first, last))
    raise ConfigError(
        f"{flag} names columns of the state as observation.state[0:7] does, of {count} that there "
        f"are; got {text[:80]!r}."
    )


def joints_of(episode: Episode, columns: JointNumbers) -> tuple[np.ndarray, np.ndarray | None]:
    """Joint angles (rad) [T, joints], and the opening from 0 to 1 [T] if the state says it.

    Args:
        episode: Of the dataset.
        columns: Which are which.

    Raises:
        DatasetError: Numbers are not finite, or no radians.
    """
    angles = episode.state[:, columns.angles].astype(float)
    if not np.isfinite(angles).all():
        raise DatasetError(f"Episode '{episode.name}': joint angles that are not finite.")
    if np.abs(angles).max() > LARGEST:
        raise DatasetError(
            f"Episode '{episode.name}': a joint angle of {np.abs(angles).max():g}; expected "
            "radians. Likely cause: degrees, or other columns (--joints)."
        )
    if columns.opening is None:
        return angles, None
    opening = episode.state[:, columns.opening].astype(float)
    opening = opening / METRES if np.abs(opening).max() < 2 * METRES and not columns.closes \
        else opening  # fmt: skip
    opening = np.clip(np.nan_to_num(opening), 0, 1)
    return angles, 1 - opening if columns.closes else opening
