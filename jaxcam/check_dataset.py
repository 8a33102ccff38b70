"""What is wrong with a dataset, and what is worth knowing of it."""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console

from jaxcam.actions import ACTION_SPACES
from jaxcam.check_cameras import check_cameras, check_poses
from jaxcam.check_evaluation import (
    camera_numbers,
    check_field_of_view,
    check_held_out,
    check_ranges,
)
from jaxcam.demos import Demo, Demos, faults_of, read_demos
from jaxcam.errors import DatasetError
from jaxcam.findings import Finding, some
from jaxcam.overlays import chosen
from jaxcam.progress import progress
from jaxcam.replay import GATE, replay_all
from jaxcam.sim import make_engine
from jaxcam.sim.controllers import CONTROL_HZ
from jaxcam.sim.engine import Start
from jaxcam.sim.task import Task
from jaxcam.sim.world import World

SHORT = 10
"""Control steps below which a demonstration can hardly show anything."""
STILL = 1e-6
"""Spread of a number over a dataset up to which it is constant."""
LEAP = 0.1
"""Change (m) of the commanded position in a control step that no arm can follow."""
ASTRAY = 0.2
"""Distance (m) between a command and where the grip is next that no controller leaves."""
APART = 1e-3
"""Distance (m) up to which the recorded grip is where the recorded joints put it."""
LISTED = 10
"""Demonstrations that are told one by one of those that cannot be used."""
REPLAY_FIX = """Commands, gripper sign, object poses or the task are not what was recorded; \
python -m jaxcam.replay tells of every demonstration."""
GRIPPER_TURNED = np.array([1, 1, 1, 1, 1, 1, -1])
"""What an action is multiplied by to open where it closed."""
COMMAND = ("x (m)", "y (m)", "z (m)", "turn x (rad)", "turn y (rad)", "turn z (rad)", "gripper")
"""The numbers of a recorded action."""
Row = tuple[str, str, str, str]
"""A quantity with its least, middle and largest value, as people write them."""


def read(path: Path) -> tuple[Demos | None, list[Finding]]:
    """Reads a file; all that is wrong with its demonstrations, if it cannot be used."""
    try:
        demos = read_demos(path)
    except DatasetError as error:
        errors = [error]
        try:
            errors = faults_of(path) or errors
        except DatasetError as whole:
            errors = [whole]
        listed = [Finding("file", "bad", str(e)) for e in errors[:LISTED]]
        if (rest := len(errors) - LISTED) > 0:
            listed.append(Finding("file", "bad", f"and {rest} more such"))
        return None, listed
    header = demos.header
    got = (
        f"{len(demos.train)} training and {len(demos.valid)} validation demonstrations of "
        f"{header.task}, {header.scene}; content {demos.fingerprint}"
    )
    return demos, [Finding("file", "good", got)]


def check_content(demos: Demos, scene: World) -> Iterator[Finding]:
    """What can be told without a simulator."""
    yield _sizes(demos, scene)
    yield _duplicates(demos)
    yield check_held_out(demos)
    poses = check_poses(demos)
    yield poses
    if poses.mark == "good":
        yield check_cameras(demos)
        yield check_ranges(demos)
    yield check_field_of_view(demos)
    every = demos.train + demos.valid
    yield _lengths(every)
    yield _commands(every)
    yield _gripper(every)
    yield _constants(every)
    yield _times(every)


def check_physics(
    demos: Demos, task: Task, scene: World, count: int, console: Console | None = None
) -> Iterator[Finding]:
    """What a simulator tells of some demonstrations; it must be there.

    Args:
        demos: the dataset.
        task: of the demonstrations.
        scene: of the demonstrations.
        count: demonstrations that are replayed.
        console: for progress; silent when None.
    """
    every = demos.train + demos.valid
    rows = chosen(len(every), count)
    some_demos = [every[i] for i in rows]
    yield _grip(some_demos, rows, task, scene)
    with progress(console, "replaying", len(rows) * len(ACTION_SPACES)) as advance:
        found = replay_all(some_demos, task, scene, tick=advance)
    fix = REPLAY_FIX
    if not found["eef_abs"].any():
        turned = [replace(d, actions=d.actions * GRIPPER_TURNED) for d in some_demos]
        if replay_all(turned, task, scene, ["eef_abs"])["eef_abs"].all():
            fix = "Likely cause: the gripper's sign is turned round. Positive closes."
    for space, success in found.items():
        failed = [f"demo_{i}" for i in rows[~success]]
        good = success.mean() >= GATE
        yield Finding(
            f"replay, {space}",
            "good" if good else "bad",
            f"{success.sum()} of {len(rows)} succeed",
            "" if good else f"at least {GATE:.0%}",
            some(failed),
            "" if good else fix,
        )


def statistics(demos: Demos) -> list[Row]:
    """Least, middle and largest value of what is worth seeing."""
    every = demos.train + demos.valid
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


def _sizes(demos: Demos, scene: World) -> Finding:
    """Whether states are of this scene as it is built here."""
    header = demos.header
    if (header.nq, header.nv) == (scene.nq, scene.nv):
        return Finding("states", "good", f"{header.nq} positions and {header.nv} velocities")
    return Finding(
        "states",
        "bad",
        f"{header.nq} positions and {header.nv} velocities",
        f"{scene.nq} and {scene.nv}, as {header.task} has here",
        fix=f"The simulator's models changed since; it was made with {header.versions}.",
    )


def _duplicates(demos: Demos) -> Finding:
    """Whether a demonstration is there twice."""
    every = demos.train + demos.valid
    same = [*_twins(every, lambda d: d.states.tobytes() + d.actions.tobytes())]
    seeds = [*_twins(every, lambda d: str(d.seed).encode())]
    if not same and not seeds:
        return Finding("duplicates", "good", f"all {len(every)} demonstrations differ")
    train = len(demos.train)
    leaks = [pair for pair in same if min(pair) < train <= max(pair)]
    got = f"{len(same)} are copies of earlier ones"
    if leaks:
        got += f", {len(leaks)} of them validation copies of training"
    if len(seeds) > len(same):
        got += f"; {len(seeds) - len(same)} more share an episode's seed"
    pairs = [f"demo_{i} = demo_{k}" for i, k in same or seeds]
    mark = "bad" if same else "note"
    return Finding("duplicates", mark, got, "none", some(pairs), "Leave the copies out.")


def _twins(every: Sequence[Demo], key: Callable[[Demo], bytes]) -> Iterator[tuple[int, int]]:
    """Each demonstration whose key an earlier one has, after that."""
    first: dict[bytes, int] = {}
    for i, demo in enumerate(every):
        digest = hashlib.sha256(key(demo)).digest()
        if first.setdefault(digest, i) != i:
            yield first[digest], i


def _lengths(every: Sequence[Demo]) -> Finding:
    lengths = np.array([d.length for d in every])
    got = f"{lengths.min()} to {lengths.max()} control steps, half below {np.median(lengths):.0f}"
    short = np.flatnonzero(lengths < SHORT)
    if not len(short):
        return Finding("lengths", "good", got)
    where = some([f"demo_{i}" for i in short])
    fix = "Chunks are padded past the end; leave out what shows nothing."
    return Finding("lengths", "note", got, f"at least {SHORT}", where, fix)


def _commands(every: Sequence[Demo]) -> Finding:
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


def _gripper(every: Sequence[Demo]) -> Finding:
    """Whether the gripper's commands are signs within their range, and whether it moves."""
    commands = np.concatenate([d.actions[:, -1] for d in every])
    got = f"{commands.min():g} to {commands.max():g}, closing {np.mean(commands > 0):.0%} of steps"
    if abs(commands).max() > 1 + STILL or (commands.min() >= 0 and np.ptp(commands) > 0):
        fix = "Positive closes, negative opens: rescale an opening or a 0-to-1 command."
        return Finding("gripper", "bad", got, "-1 opens to 1 closes", fix=fix)
    if not any(map(_changes, every)):
        return Finding("gripper", "note", f"{got}; it never changes")
    return Finding("gripper", "good", got)


def _constants(every: Sequence[Demo]) -> Finding:
    spread = np.ptp(np.concatenate([d.actions for d in every]), axis=0)
    constant = [name for name, s in zip(COMMAND[:-1], spread[:-1], strict=True) if s <= STILL]
    if not constant:
        return Finding("constant commands", "good", "none")
    fix = "Statistics have a floor, so nothing blows up; but a policy learns nothing of these."
    return Finding("constant commands", "note", some(constant), "none", fix=fix)


def _times(every: Sequence[Demo]) -> Finding:
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


def _grip(demos: Sequence[Demo], rows: np.ndarray, task: Task, scene: World) -> Finding:
    """Whether the recorded grip is where the simulator has it for the recorded joints."""
    start = Start(
        qpos=np.stack([d.states[0, 1 : 1 + scene.nq] for d in demos]),
        geom_size=np.stack([d.geom_size for d in demos]),
        fixtures=np.stack([d.fixtures for d in demos]),
    )
    engine = make_engine(scene.engines[0], scene, "osc_pose", task.varied)
    there = np.asarray(engine.reset(start).grip_position)
    apart = np.linalg.norm(there - [d.eef_pos[0] for d in demos], axis=-1)
    got = f"within {apart.max() * 1000:.2g} mm of where the joints put it"
    if apart.max() <= APART:
        return Finding("grip", "good", got)
    where = some([f"demo_{i}" for i in rows[apart > APART]])
    fix = "obs/robot0_eef_pos is the grip site in the world, in metres; states are of this robot."
    return Finding("grip", "bad", got, f"within {APART * 1000:g} mm", where, fix)
