"""What the actions of a robosuite demonstration ask for: absolute targets of its grip.

`Controller` turns the actions of robosuite's OSC_POSE into targets (control laws of robosuite 1.4.1
and 1.5.2, `controllers/.../osc.py`). What a file says of its controller may be wrong, though:
absolute actions are often kept beside the `env_args` of deltas. Its states are the witness, see
`jaxcam.interop.robosuite_witness`.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from jaxcam.errors import DatasetError
from jaxcam.interop.robosuite_model import GripPath, Origin
from jaxcam.interop.robosuite_witness import FINGERS_STRAY, STRAY, Missed, Witness
from jaxcam.rays.rotations import matrix_from_rotvec, rotvec_from_matrix
from jaxcam.sim.controllers import OSC_KP

ActionReading = Literal["commands", "deltas", "absolute"]
"""How actions are read: as the file says, or as asked."""


@dataclass(frozen=True)
class Controller:
    """The OSC_POSE controller that a file's actions were given to."""

    input_range: np.ndarray
    """Smallest and largest action [2, 6]."""
    output_range: np.ndarray
    """What these stand for (m, rad) [2, 6]."""
    is_delta: bool
    in_base: bool
    """Whether actions are in the axes of the robot's base or in the world's."""
    keeps_rotation: bool
    """Whether a rotation of zero keeps the orientation asked for last, as in robosuite 1.4."""
    position_limits: np.ndarray | None = None
    """Box (m; the recorded world) that targets are clipped to [2, 3], as robosuite 1.4 does."""

    def targets(self, actions: np.ndarray, origin: Origin, path: GripPath) -> np.ndarray:
        """Absolute targets (m, rotation vector; the scene's world) [T, 6].

        Args:
            actions: Of the arm [T, 6].
            origin: Of the demonstration.
            path: Where the grip was before each action (the scene's world).
        """
        frame = origin.world_from_theirs.copy()
        if self.in_base:
            frame = frame @ origin.theirs_from_controller
        axes = frame[:3, :3]
        if self.is_delta:
            place, goal = self._moved(actions, axes, path)
        else:
            place = actions[:, :3] @ axes.T + frame[:3, 3]
            goal = axes @ matrix_from_rotvec(actions[:, 3:])
        if self.position_limits is not None:
            theirs = (place - frame[:3, 3]) @ axes
            place = np.clip(theirs, *self.position_limits) @ axes.T + frame[:3, 3]
        return np.concatenate([place, rotvec_from_matrix(goal)], -1)

    def _moved(
        self, actions: np.ndarray, axes: np.ndarray, path: GripPath
    ) -> tuple[np.ndarray, np.ndarray]:
        """Positions [T, 3] and axes [T, 3, 3] that deltas ask for."""
        (low, high), (least, most) = self.input_range, self.output_range
        share = (np.clip(actions, low, high) - low) / (high - low)
        moves = least + share * (most - least)
        turn = axes @ matrix_from_rotvec(moves[:, 3:]) @ axes.T
        goal = turn @ path.rotation
        if self.keeps_rotation:
            kept = path.rotation[0]
            for t, still in enumerate(np.isclose(moves[:, 3:], 0, rtol=0, atol=1e-12).all(-1)):
                kept = goal[t] = kept if still else goal[t]
        return path.position + moves[:, :3] @ axes.T, goal


def disagreement(
    controller: Controller, actions: np.ndarray, signs: np.ndarray, origin: Origin, witness: Witness
) -> str:
    """How the commands of a demonstration disagree with its states, and the way out; "" if not.

    Args:
        controller: As its actions are read.
        actions: Of the arm [T, 6].
        signs: Of the gripper's commands, positive closes [T - 1].
        origin: Of the demonstration.
        witness: Its states.
    """

    def missed(reading: Controller) -> Missed:
        return witness.missed(reading.targets(actions, origin, witness.path)[:-1], signs)

    off = missed(controller)
    if off.arm <= STRAY:
        if off.fingers <= FINGERS_STRAY:
            return ""
        return (
            "its fingers do not go where commands send them: in robosuite positive closes and "
            "negative opens. Import with --actions states, which takes the gripper's command from "
            "its fingers."
        )
    other = replace(controller, is_delta=not controller.is_delta)
    reading = {True: "deltas", False: "absolute poses"}
    message = (
        f"its commands, read as {reading[controller.is_delta]}, do not lead where its states go: "
        f"a control step later the grip is elsewhere by {off.arm:.0%} of what they ask."
    )
    if missed(other).arm <= STRAY:
        return (
            f"{message} As {reading[other.is_delta]} they do, whatever env_args says: import with "
            f"--actions {'deltas' if other.is_delta else 'absolute'}."
        )
    return f"{message} Import with --actions states."


def read_controller(
    settings: Any, reading: ActionReading = "commands", version: str = ""
) -> Controller:
    """Reads `controller_configs` of robosuite 1.4 (one arm's) or 1.5 (of body parts).

    Each version ignores what it does not know: 1.4 the settings `input_type` and
    `input_ref_frame`, 1.5 `control_delta`. Given one arm's settings, 1.5 puts them into its own.

    Args:
        settings: As JSON has them.
        reading: Whether actions are deltas: as the settings say, or as asked.
        version: Of robosuite, as the file says; "" where it does not.

    Raises:
        DatasetError: If the actions are no OSC_POSE targets that ours would follow alike.
    """
    is_list = isinstance(settings, Sequence) and not isinstance(settings, str)
    part: Any = settings[0] if is_list and settings else settings
    is_composite = isinstance(part, Mapping) and "body_parts" in part
    if is_composite:
        kind = part.get("type", "BASIC")
        part = part["body_parts"]
        for level in ("arms", "right"):
            if isinstance(part, Mapping):
                part = part.get(level, part if level == "arms" else None)
        if kind != "BASIC":
            raise DatasetError(f"a composite controller of type {kind!r}; expected 'BASIC'.")
    if not isinstance(part, Mapping):
        raise DatasetError("env_args names no controller.")
    is_new = is_composite or _at_least_15(version)
    _check_law(part, is_new)
    is_delta = (
        part.get("input_type") != "absolute" if is_new else bool(part.get("control_delta", 1))
    )
    return Controller(
        input_range=_range(part, "input", 1.0),
        output_range=_range(part, "output", [0.05, 0.05, 0.05, 0.5, 0.5, 0.5]),
        is_delta=is_delta if reading == "commands" else reading == "deltas",
        in_base=is_new and part.get("input_ref_frame", "base") == "base",
        keeps_rotation=not is_new,
        position_limits=_box(part.get("position_limits")),
    )


def _at_least_15(version: str) -> bool:
    """Whether this is robosuite 1.5 or newer."""
    numbers = re.match(r"(\d{1,4})\.(\d{1,4})", version)
    return numbers is not None and (int(numbers[1]), int(numbers[2])) >= (1, 5)


def _check_law(part: Mapping[str, Any], is_new: bool) -> None:
    """Refuses each setting by which the arm would do something else than ours with a target."""
    gripper = part.get("gripper", {})
    wanted: dict[str, tuple[Any, Any]] = {
        "type": (part.get("type"), "OSC_POSE"),
        "impedance_mode": (part.get("impedance_mode", "fixed"), "fixed"),
        "kp": (part.get("kp", OSC_KP), OSC_KP),
        "damping_ratio": (part.get("damping_ratio", part.get("damping", 1)), 1),
        "uncouple_pos_ori": (part.get("uncouple_pos_ori", True), True),
        "interpolation": (part.get("interpolation"), None),
        "orientation_limits": (part.get("orientation_limits"), None),
    }
    if is_new:  # robosuite 1.5 has limits among its settings, but not in its code
        wanted["position_limits"] = (part.get("position_limits"), None)
        kind = gripper.get("type", "GRIP") if isinstance(gripper, Mapping) else gripper
        wanted["gripper"] = (kind, "GRIP")
        if (frame := part.get("input_ref_frame", "base")) != "world":
            wanted["input_ref_frame"] = (frame, "base")
        if (kind := part.get("input_type", "delta")) != "absolute":
            wanted["input_type"] = (kind, "delta")
    wrong = [name for name, (value, right) in wanted.items() if not _is_all(value, right)]
    if wrong:
        raise DatasetError(
            "its actions were given to a controller of "
            + ", ".join(f"{k} {wanted[k][0]!r} (expected {wanted[k][1]!r})" for k in wrong)
            + "."
        )


def _is_all(value: Any, right: Any) -> bool:
    """Whether a setting is `right`, or a list of nothing else."""
    if isinstance(value, list) and isinstance(right, int | float):
        return bool(value) and all(_is_all(entry, right) for entry in value)
    return not isinstance(value, list | dict) and value == right


def _range(part: Mapping[str, Any], which: str, most: Any) -> np.ndarray:
    """Smallest and largest of actions, or of what they stand for [2, 6]."""
    high = _numbers(part, f"{which}_max", most)
    low = _numbers(part, f"{which}_min", np.negative(most))
    if (low > high).any() or (which == "input" and (low == high).any()):
        raise DatasetError(
            f"{which}_min {low.tolist()} is not below {which}_max {high.tolist()} in its "
            "controller."
        )
    return np.stack([low, high])


def _numbers(part: Mapping[str, Any], name: str, default: Any) -> np.ndarray:
    """A setting that is a number or six of them [6]."""
    value = part.get(name, default)
    try:
        numbers = np.asarray(value, float)
    except (TypeError, ValueError):
        numbers = np.array(np.nan)
    if numbers.shape not in ((), (6,)) or not np.isfinite(numbers).all():
        raise DatasetError(f"{name} {value!r} of its controller; expected a number, or six.")
    return np.broadcast_to(numbers, 6)


def _box(limits: Any) -> np.ndarray | None:
    """Position limits (m) [2, 3], if there are any."""
    if limits is None:
        return None
    try:
        box = np.asarray(limits, float)
    except (TypeError, ValueError):
        box = np.array(np.nan)
    if box.shape != (2, 3) or not np.isfinite(box).all() or (box[0] > box[1]).any():
        raise DatasetError(
            f"position_limits {limits!r} of its controller; expected the smallest and the largest "
            "position, of three numbers each."
        )
    return box
