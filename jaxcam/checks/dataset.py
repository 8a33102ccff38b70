"""What is wrong with a dataset, and what is worth knowing of it."""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from rich.console import Console

from jaxcam.checks.cameras import check_cameras, check_poses
from jaxcam.checks.findings import Finding, bad, good, note
from jaxcam.checks.held_out import check_field_of_view, check_held_out, check_ranges
from jaxcam.checks.numbers import (
    check_commands,
    check_constants,
    check_errors,
    check_gripper,
    check_lengths,
    check_rate,
    check_rotations,
)
from jaxcam.checks.overlays import chosen
from jaxcam.console.progress import progress
from jaxcam.console.words import some
from jaxcam.data.demos import Demo, Demos, faults_of, read_demos
from jaxcam.data.replay import GATE, replay_all
from jaxcam.errors import DatasetError
from jaxcam.sim import make_engine
from jaxcam.sim.actions import ACTION_SPACES
from jaxcam.sim.task import Task
from jaxcam.sim.types import Start
from jaxcam.sim.world import World

APART = 1e-3
"""Distance (m) up to which the recorded grip is where the recorded joints put it."""
TURNED = 1e-2
"""Angle (rad) up to which its axes are those that the joints give it."""
LOOKED = 32
"""States of a demonstration in which its grip is looked at."""
LISTED = 10
"""Faults of a file that are listed one by one."""
REPLAY_FIX = """Commands, gripper sign, object poses or the task are not what was recorded; \
python -m jaxcam.replay lists the demonstrations that fail."""
GRIPPER_TURNED = np.array([1, 1, 1, 1, 1, 1, -1])
"""What an action is multiplied by to open where it closed."""
Item = TypeVar("Item")


def check_file(path: Path) -> tuple[Demos | None, list[Finding]]:
    """Reads a file; if it cannot be used, says all that is wrong with its demonstrations."""
    try:
        demos = read_demos(path)
    except DatasetError as error:
        errors = [error]
        try:
            errors = faults_of(path) or errors
        except DatasetError as of_the_file:
            errors = [of_the_file]
        listed = [bad("file", got=str(e)) for e in errors[:LISTED]]
        if (rest := len(errors) - LISTED) > 0:
            listed.append(bad("file", got=f"and {rest} more such"))
        return None, listed
    header = demos.header
    got = (
        f"{len(demos.train)} training and {len(demos.valid)} validation demonstrations of "
        f"{header.task}, {header.scene}; content {demos.fingerprint}"
    )
    return demos, [good("file", got=got)]


def check_content(demos: Demos, scene: World) -> Iterator[Finding]:
    """Checks that need no simulator."""
    yield _sizes(demos, scene)
    yield _duplicates(demos)
    yield check_held_out(demos)
    poses = check_poses(demos)
    yield poses
    if poses.mark == "good":
        yield check_cameras(demos)
        yield check_ranges(demos)
    yield check_field_of_view(demos)
    episodes = demos.episodes
    checks = check_lengths, check_commands, check_gripper, check_constants, check_rate, check_errors
    for check in checks:
        yield check(episodes)
    yield check_rotations(episodes, scene.nominal_grip)


def check_physics(
    demos: Demos, task: Task, scene: World, count: int, console: Console | None = None
) -> Iterator[Finding]:
    """Replays some demonstrations, for which this machine must have their simulator.

    Args:
        demos: The dataset.
        task: Of the demonstrations.
        scene: Of the demonstrations.
        count: Demonstrations that are replayed.
        console: For progress; silent when None.
    """
    episodes = demos.episodes
    rows = chosen(len(episodes), count)
    replayed = [episodes[i] for i in rows]
    yield _grip(replayed, rows, task, scene)
    with progress(console, "replaying", len(rows) * len(ACTION_SPACES)) as advance:
        successes = replay_all(replayed, task, scene, tick=advance)
    fix = REPLAY_FIX
    if not successes["eef_abs"].any():
        turned = [replace(d, actions=d.actions * GRIPPER_TURNED) for d in replayed]
        if replay_all(turned, task, scene, ["eef_abs"])["eef_abs"].all():
            fix = "Likely cause: the gripper's sign is turned round. Positive closes."
    for space, success in successes.items():
        failed = [f"demo_{i}" for i in rows[~success]]
        what, got = f"replay, {space}", f"{success.sum()} of {len(rows)} succeed"
        if success.mean() >= GATE:
            yield good(what, got=got, where=some(failed))
        else:
            yield bad(what, got=got, expected=f"at least {GATE:.0%}", where=some(failed), fix=fix)


def _sizes(demos: Demos, scene: World) -> Finding:
    """Whether states are of this scene as it is built here."""
    header = demos.header
    if (header.nq, header.nv) == (scene.nq, scene.nv):
        return good("states", got=f"{header.nq} positions and {header.nv} velocities")
    return bad(
        "states",
        got=f"{header.nq} positions and {header.nv} velocities",
        expected=f"{scene.nq} and {scene.nv}, as {header.task} has here",
        fix=f"The simulator's models changed since; it was made with {header.versions}.",
    )


def _duplicates(demos: Demos) -> Finding:
    """Whether a demonstration is there twice."""
    episodes = demos.episodes
    same = [*twins(episodes, lambda d: d.states.tobytes() + d.actions.tobytes())]
    seeds = [*twins(episodes, lambda d: str(d.seed).encode())]
    if not same and not seeds:
        return good("duplicates", got=f"all {len(episodes)} demonstrations differ")
    train = len(demos.train)
    leaks = [pair for pair in same if min(pair) < train <= max(pair)]
    got = f"{len(same)} are copies of earlier ones"
    if leaks:
        got += f", {len(leaks)} of them validation copies of training"
    if len(seeds) > len(same):
        got += f"; {len(seeds) - len(same)} more share an episode's seed"
    pairs = [f"demo_{i} = demo_{k}" for i, k in same or seeds]
    finding = bad if same else note
    return finding(
        "duplicates",
        got=got,
        expected="none",
        where=some(pairs),
        fix="Leave the copies out.",
    )


def twins(items: Sequence[Item], key: Callable[[Item], bytes]) -> Iterator[tuple[int, int]]:
    """Numbers of each item whose key an earlier one has: the earlier one, then its own."""
    first: dict[bytes, int] = {}
    for i, item in enumerate(items):
        digest = hashlib.sha256(key(item)).digest()
        if first.setdefault(digest, i) != i:
            yield first[digest], i


def _grip(demos: Sequence[Demo], rows: np.ndarray, task: Task, scene: World) -> Finding:
    """Whether the recorded grip is where the simulator has it for the recorded joints."""
    engine = make_engine(None, scene, "osc_pose", task.varied)
    far, turned = np.zeros(len(demos)), np.zeros(len(demos))
    for i, demo in enumerate(demos):
        steps = chosen(len(demo.qpos), LOOKED)
        same = (np.broadcast_to(x, (len(steps), *x.shape)) for x in demo.start()[1:])
        there = engine.reset(Start(demo.qpos[steps], *same))
        grip = demo.world_from_grip()[steps]
        far[i] = np.linalg.norm(there.grip_position - grip[:, :3, 3], axis=-1).max()
        cosine = (np.einsum("nij,nij->n", there.grip_rotation, grip[:, :3, :3]) - 1) / 2
        turned[i] = np.arccos(np.clip(cosine, -1, 1)).max()
    got = f"within {far.max() * 1000:.2g} mm and {np.rad2deg(turned.max()):.1f}° of where the "
    got += "joints put it"
    wrong = (far > APART) | (turned > TURNED)
    if not wrong.any():
        return good("grip", got=got)
    where = some([f"demo_{i}" for i in rows[wrong]])
    fix = (
        "obs/robot0_eef_pos and _quat (xyzw) are the grip site in the world, in metres; states are "
    )
    fix += "of this robot."
    expected = f"within {APART * 1000:g} mm and {np.rad2deg(TURNED):.2g}°"
    return bad("grip", got=got, expected=expected, where=where, fix=fix)
