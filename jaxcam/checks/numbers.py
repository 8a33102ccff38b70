"""What the numbers of demonstrations tell: lengths, commands, gripper, rate."""

from collections.abc import Iterable, Sequence

import numpy as np

from jaxcam.checks.findings import Finding, some
from jaxcam.checks.held_out import camera_numbers
from jaxcam.data.demos import Demo, Demos
from jaxcam.sim.controllers import CONTROL_HZ

SHORT = 10
"""Control steps below which a demonstration can hardly show anything."""
STILL = 1e-6
"""Spread of a number over a dataset up to which it is constant."""
LEAP = 0.1
"""Change (m) of the commanded position in a control step that no arm can follow."""
ASTRAY = 0.2
"""Distance (m) between a command and where the grip is next that no controller leaves."""
COMMAND = ("x (m)", "y (m)", "z (m)", "turn x (rad)", "turn y (rad)", "turn z (rad)", "gripper")
"""The numbers of a recorded action."""
Row = tuple[str, str, str, str]
"""A quantity with its least, middle and largest value, as people write them."""


def check_lengths(every: Sequence[Demo]) -> Finding:
    """Whether demonstrations are long enough to show something."""
    lengths = np.array([d.length for d in every])
    got = f"{lengths.min()} to {lengths.max()} control steps, half below {np.median(lengths):.0f}"
    short = np.flatnonzero(lengths < SHORT)
    if not len(short):
        return Finding("lengths", "good", got)
    where = some([f"demo_{i}" for i in short])
    fix = "Chunks are padded past the end; leave out what shows nothing."
    return Finding("lengths", "note", got, f"at least {SHORT}", where, fix)


def check_commands(every: Sequence[Demo]) -> Finding:
    """Whether commands are poses near the grip, in its frame and unit, and move steadily."""
    astray = [np.median(np.linalg.norm(d.actions[:, :3] - d.eef_pos[1:], axis=-1)) for d in every]
    leaps = [_leap(d.actions[:, :3]) for d in every]
    got = f"{np.median(astray) * 1000:.0f} mm from where the grip is next"
    if bad := _over(astray, ASTRAY):
        fix = "Commands are grip poses in the world, in metres: other frames, units or deltas fail."
        return Finding(
            "commands",
            "bad",
            f"up to {max(astray):.2g} m from where the grip is next",
            f"at most {ASTRAY:g} m",
            some(bad),
            fix,
        )
    if bad := _over(leaps, LEAP):
        return Finding(
            "commands",
            "note",
            f"they leap by up to {max(leaps):.2g} m in a control step",
            f"at most {LEAP:g} m",
            some(bad),
            "No arm can follow.",
        )
    return Finding("commands", "good", got)


def _leap(positions: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(positions, axis=0), axis=-1).max(initial=0.0))


def _over(values: Iterable[float], limit: float) -> list[str]:
    return [f"demo_{i}" for i, value in enumerate(values) if not value <= limit]


def _changes(demo: Demo) -> int:
    return int(np.count_nonzero(np.diff(np.sign(demo.actions[:, -1]))))


def check_gripper(every: Sequence[Demo]) -> Finding:
    """Whether the gripper's commands are signs within their range, and whether it moves."""
    commands = np.concatenate([d.actions[:, -1] for d in every])
    got = f"{commands.min():g} to {commands.max():g}, closing {np.mean(commands > 0):.0%} of steps"
    if abs(commands).max() > 1 + STILL or (commands.min() >= 0 and np.ptp(commands) > 0):
        fix = "Positive closes, negative opens: rescale an opening or a 0-to-1 command."
        return Finding("gripper", "bad", got, "-1 opens to 1 closes", fix=fix)
    if not any(map(_changes, every)):
        return Finding("gripper", "note", f"{got}; it never changes")
    return Finding("gripper", "good", got)


def check_constants(every: Sequence[Demo]) -> Finding:
    """Whether every number of the commanded poses varies over the dataset."""
    spread = np.ptp(np.concatenate([d.actions for d in every]), axis=0)
    constant = [name for name, s in zip(COMMAND[:-1], spread[:-1], strict=True) if s <= STILL]
    if not constant:
        return Finding("constant commands", "good", "none")
    fix = "Statistics have a floor, so nothing blows up; but a policy learns nothing of these."
    return Finding("constant commands", "note", some(constant), "none", fix=fix)


def check_rate(every: Sequence[Demo]) -> Finding:
    """Whether states are a control step apart."""
    steps = np.concatenate([np.diff(d.states[:, 0]) for d in every])
    if np.allclose(steps, 1 / CONTROL_HZ, atol=1e-6):
        return Finding("rate", "good", f"{CONTROL_HZ:g} control steps a second")
    bad = [not np.allclose(np.diff(d.states[:, 0]), 1 / CONTROL_HZ, atol=1e-6) for d in every]
    where = some([f"demo_{i}" for i in np.flatnonzero(bad)])
    got = f"states are {steps.min():.4g} to {steps.max():.4g} s apart"
    return Finding(
        "rate",
        "bad",
        got,
        f"{1 / CONTROL_HZ:g} s",
        where,
        "Resample: a command lasts one control step.",
    )


def statistics(demos: Demos) -> list[Row]:
    """Least, middle and largest value of what is worth seeing."""
    every = demos.episodes
    actions = np.concatenate([d.actions for d in every])
    places = np.concatenate([d.eef_pos for d in every])
    quantities: list[tuple[str, np.ndarray]] = [
        ("control steps", np.array([d.length for d in every])),
        *((f"command, {name}", x) for name, x in zip(COMMAND, actions.T, strict=True)),
        *((f"grip, {name}", x) for name, x in zip(COMMAND[:3], places.T, strict=True)),
        ("gripper's changes", np.array([_changes(d) for d in every])),
    ]
    quantities += camera_numbers(demos).items()
    return [
        (name, f"{x.min():.4g}", f"{np.median(x):.4g}", f"{x.max():.4g}") for name, x in quantities
    ]
