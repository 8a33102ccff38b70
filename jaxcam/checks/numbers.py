"""Whether the numbers of demonstrations make sense: lengths, commands, gripper, rate."""

from collections.abc import Iterable, Sequence

import numpy as np

from jaxcam.checks.findings import Finding, bad, good, note
from jaxcam.checks.held_out import camera_numbers
from jaxcam.console.words import some
from jaxcam.data.demos import Demo, Demos
from jaxcam.data.recorded.recording import Episode
from jaxcam.sim.actions import encode
from jaxcam.sim.controllers import CONTROL_HZ

SHORT = 10
"""Control steps below which a demonstration can hardly show anything."""
STILL = 1e-6
"""Spread of a number over a dataset up to which it is constant."""
LEAP = 0.1
"""Change (m) of the commanded position in a control step that no arm can follow."""
TURN = 1.0
"""Change (rad) of the commanded rotation in a control step that no arm can follow."""
ASTRAY = 0.2
"""Distance (m) between a command and where the grip is next that no controller leaves."""
COMMAND_PARTS = (
    "x (m)",
    "y (m)",
    "z (m)",
    "turn x (rad)",
    "turn y (rad)",
    "turn z (rad)",
    "gripper",
)
"""The numbers of a recorded action."""
Spread = tuple[str, str, str, str]
"""A quantity with its least, middle and largest value, as people write them."""


def check_lengths(episodes: Sequence[Demo]) -> Finding:
    """Whether demonstrations are long enough to show something."""
    lengths = np.array([d.length for d in episodes])
    got = f"{lengths.min()} to {lengths.max()} control steps, half below {np.median(lengths):.0f}"
    short = np.flatnonzero(lengths < SHORT)
    if not len(short):
        return good("lengths", got=got)
    where = some([f"demo_{i}" for i in short])
    fix = "Chunks are padded past the end; leave out what shows nothing."
    return note("lengths", got=got, expected=f"at least {SHORT}", where=where, fix=fix)


def check_commands(episodes: Sequence[Demo]) -> Finding:
    """Whether commands are poses near the grip, in its frame and unit, and move steadily."""
    astray = [
        np.median(np.linalg.norm(d.actions[:, :3] - d.eef_pos[1:], axis=-1)) for d in episodes
    ]
    leaps = [_leap(d.actions[:, :3]) for d in episodes]
    got = f"{np.median(astray) * 1000:.0f} mm from where the grip is next"
    if names := _over(astray, ASTRAY):
        fix = "Commands are grip poses in the world, in metres: other frames, units or deltas fail."
        return bad(
            "commands",
            got=f"up to {max(astray):.2g} m from where the grip is next",
            expected=f"at most {ASTRAY:g} m",
            where=some(names),
            fix=fix,
        )
    if names := _over(leaps, LEAP):
        return note(
            "commands",
            got=f"they leap by up to {max(leaps):.2g} m in a control step",
            expected=f"at most {LEAP:g} m",
            where=some(names),
            fix="No arm can follow.",
        )
    return good("commands", got=got)


def _leap(positions: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(positions, axis=0), axis=-1).max(initial=0.0))


def _over(values: Iterable[float], limit: float) -> list[str]:
    return [f"demo_{i}" for i, value in enumerate(values) if not value <= limit]


def _changes(demo: Demo) -> int:
    return int(np.count_nonzero(np.diff(np.sign(demo.actions[:, -1]))))


def check_gripper(episodes: Sequence[Demo]) -> Finding:
    """Whether the gripper's commands are signs within their range, and whether it moves."""
    commands = np.concatenate([d.actions[:, -1] for d in episodes])
    got = f"{commands.min():g} to {commands.max():g}, closing {np.mean(commands > 0):.0%} of steps"
    if abs(commands).max() > 1 + STILL or (commands.min() >= 0 and np.ptp(commands) > 0):
        fix = "Positive closes, negative opens: rescale an opening or a 0-to-1 command."
        return bad("gripper", got=got, expected="-1 opens to 1 closes", fix=fix)
    if not any(map(_changes, episodes)):
        return note("gripper", got=f"{got}; it never changes")
    return good("gripper", got=got)


def check_constants(episodes: Sequence[Demo]) -> Finding:
    """Whether every number of the commanded poses varies over the dataset."""
    spread = np.ptp(np.concatenate([d.actions for d in episodes]), axis=0)
    constant = [name for name, s in zip(COMMAND_PARTS[:-1], spread[:-1], strict=True) if s <= STILL]
    if not constant:
        return good("constant commands", got="none")
    fix = "Statistics have a floor, so nothing blows up; but a policy learns nothing of these."
    return note("constant commands", got=some(constant), expected="none", fix=fix)


def check_rotations(episodes: Sequence[Demo], nominal: np.ndarray) -> Finding:
    """Whether rotations as numbers go as steadily as the rotations themselves.

    Args:
        episodes: The demonstrations.
        nominal: What a policy of `eef_abs` counts rotations from (`World.nominal_grip`).
    """
    poses = [d.actions[:, :-1] for d in episodes]
    learned = [encode("eef_abs", p, p[:, 0], p[0], nominal)[:, 3:6] for p in poses]
    turns = [encode("eef_delta", p, p[:, 0], p[0], nominal)[:, 3:6] for p in poses]
    if names := _over([_longest(x) for x in turns], TURN):
        return note(
            "rotations",
            got=f"commands turn by up to {max(map(_longest, turns)):.2g} rad in a control step",
            expected=f"at most {TURN:g} rad",
            where=some(names),
            fix="No arm can follow.",
        )
    farthest = max(map(_longest, learned))
    stored = _over([_longest(np.diff(p[:, 3:], axis=0)) for p in poses], np.pi)
    got = f"as eef_abs has them within {farthest:.2g} rad of a grip that points down"
    if farthest > np.pi:
        where = some(_over(map(_longest, learned), np.pi))
        fix = "One pose has two names, a turn apart, in eef_abs. Choose eef_delta."
        return note("rotations", got=got, expected="within half a turn", where=where, fix=fix)
    if stored:
        count = f"{len(stored)} of {len(episodes)} demonstrations"
        got = f"rotation vectors jump by a turn in {count}; {got}"
        fix = "eef_abs and eef_delta do not jump; eef_delta_componentwise and --rotations world do."
        return note("rotations", got=got, where=some(stored), fix=fix)
    return good("rotations", got=got)


def _longest(vectors: np.ndarray) -> float:
    return float(np.linalg.norm(vectors, axis=-1).max(initial=0.0))


def check_errors(episodes: Sequence[Demo | Episode]) -> Finding:
    """How many commands err on purpose."""
    each = [demo.errors.sum() for demo in episodes if demo.errors is not None]
    some_errors = [count for count in each if count]
    share = sum(some_errors) / sum(demo.length for demo in episodes)
    got = f"{share:.1%} of the actions, in {len(some_errors)} demonstrations: not taught"
    return good("errors on purpose", got=got if some_errors else "none")


def check_rate(episodes: Sequence[Demo]) -> Finding:
    """Whether states are a control step apart."""
    steps = np.concatenate([np.diff(d.states[:, 0]) for d in episodes])
    if np.allclose(steps, 1 / CONTROL_HZ, atol=1e-6):
        return good("rate", got=f"{CONTROL_HZ:g} control steps a second")
    off = [not np.allclose(np.diff(d.states[:, 0]), 1 / CONTROL_HZ, atol=1e-6) for d in episodes]
    where = some([f"demo_{i}" for i in np.flatnonzero(off)])
    got = f"states are {steps.min():.4g} to {steps.max():.4g} s apart"
    return bad(
        "rate",
        got=got,
        expected=f"{1 / CONTROL_HZ:g} s",
        where=where,
        fix="Resample: a command lasts one control step.",
    )


def statistics(demos: Demos) -> list[Spread]:
    """Least, middle and largest value of what is worth seeing."""
    episodes = demos.episodes
    actions = np.concatenate([d.actions for d in episodes])
    places = np.concatenate([d.eef_pos for d in episodes])
    quantities: list[tuple[str, np.ndarray]] = [
        ("control steps", np.array([d.length for d in episodes])),
        *((f"command, {name}", x) for name, x in zip(COMMAND_PARTS, actions.T, strict=True)),
        *((f"grip, {name}", x) for name, x in zip(COMMAND_PARTS[:3], places.T, strict=True)),
        ("gripper's changes", np.array([_changes(d) for d in episodes])),
    ]
    quantities += camera_numbers(demos).items()
    return [
        (name, f"{x.min():.4g}", f"{np.median(x):.4g}", f"{x.max():.4g}") for name, x in quantities
    ]
