"""`python -m jaxcam.collect`: demonstrations of the scripted expert, as states and commands."""

from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from jaxcam.config.conditions import of_task
from jaxcam.config.datasets import CollectConfig
from jaxcam.config.fields import fill
from jaxcam.console.paces import collecting_job
from jaxcam.console.progress import progress
from jaxcam.data.demos import Demo, Demos, read_demos
from jaxcam.data.header import CAMERA_ARRAYS, Header, optics_ranges, said_optics
from jaxcam.data.replay import replay_all
from jaxcam.data.splits import TRAIN_CAMERAS, VALIDATION_CAMERAS, episode_seeds
from jaxcam.data.writer import DemoWriter
from jaxcam.errors import SimError
from jaxcam.files.locks import exclusive
from jaxcam.files.paths import home
from jaxcam.interrupts import check_stop
from jaxcam.rays import sample_poses, stair, stair_cameras
from jaxcam.rays.optics import sample_optics
from jaxcam.rays.rotations import rotvec_from_matrix
from jaxcam.sim import make_engine, make_task, simulator_of
from jaxcam.sim.engine import Engine
from jaxcam.sim.task import Task, starts
from jaxcam.sim.types import Aim, Command, ExpertSight, Start, State
from jaxcam.sim.world import World

BATCH = 50
"""Episodes that are run side by side."""
LEAST_SUCCESS = 0.9
"""Share of episodes worth keeping below which something is broken and collection stops."""


def in_task(config: CollectConfig) -> CollectConfig:
    """The config as its task has it: n and m where it leaves them open, its own field of view."""
    task = make_task(config.task)
    n, m = task.stair
    return of_task(fill(config, n=n, m=m), task.fovy_deg)


def dataset_path(config: CollectConfig) -> Path:
    """Where a dataset lies: its name holds every setting that shapes it."""
    config = in_task(config)
    name = f"{config.task}-{config.scene}-n{config.n}m{config.m}-{config.demos}+{config.validation}"
    optics = "".join(f"-{k}{v}" for k, v in said_optics(config).items())
    name += optics.replace(":", "_").replace(",", "+")
    return home(config.data_dir) / f"{name}-seed{config.seed}.hdf5"


def collect(config: CollectConfig, console: Console | None = None) -> Demos:
    """Collects what is missing of a dataset and reads it.

    Args:
        config: What to collect.
        console: For progress; silent when None.

    Returns:
        The complete dataset. An existing file is read and checked, an unfinished one continued.
    """
    config = in_task(config)
    path = dataset_path(config)
    if not path.exists():
        task = make_task(config.task)
        task.require()
        scene = task.scene(config.scene)
        with exclusive(path, console):
            if not path.exists():
                with DemoWriter(path, new_header(config, task, scene)) as writer:
                    _fill(writer, task, scene, console)
                    writer.finish()
    return read_demos(path, task=config.task, scene=config.scene)


def new_header(config: CollectConfig, task: Task, scene: World) -> Header:
    """What the file of a complete config says of itself, its cameras drawn."""
    counts = {
        TRAIN_CAMERAS: stair_cameras(config.demos, config.n, config.m),
        VALIDATION_CAMERAS: config.validation,
    }
    poses = [sample_poses(task.cameras, count, seed) for seed, count in counts.items()]
    own: dict[str, Any] = {}
    if ranges := optics_ranges(config, task.fovy_deg):
        drawn = [sample_optics(ranges, count, seed) for seed, count in counts.items()]
        parts = dict(zip(CAMERA_ARRAYS, zip(*drawn, strict=True), strict=True))
        own = {name: np.concatenate(some) for name, some in parts.items() if some[0] is not None}
    packages = ("jaxcam", *simulator_of(scene).packages, "numpy")
    return Header(
        task=config.task,
        scene=config.scene,
        n=config.n,
        m=config.m,
        seed=config.seed,
        train=config.demos,
        valid=config.validation,
        fovy_deg=task.fovy_deg,
        nq=scene.nq,
        nv=scene.nv,
        world_from_camera=np.concatenate(poses),
        versions={name: version(name) for name in packages},
        optics=said_optics(config),
        **own,
    )


def camera_windows(header: Header) -> list[np.ndarray]:
    """Rows of the cameras that see each demonstration: the stair's, then one each held out."""
    cameras = len(header.world_from_camera)
    held_out = np.arange(cameras - header.valid, cameras)
    return [*stair(header.train, header.n, header.m), *held_out[:, None]]


def _fill(writer: DemoWriter, task: Task, scene: World, console: Console | None) -> None:
    """Runs expert episodes until every slot of the file has one that replays in every space."""
    header = writer.header
    total = header.train + header.valid
    cameras = camera_windows(header)
    engine = make_engine(None, scene, "osc_pose", task.varied)
    seeds = episode_seeds(header.seed)
    tried = succeeded = kept = 0
    unsteady: list[int] = []
    job = collecting_job(task.name, header.scene)
    with progress(console, "collecting", total, done=len(writer.done), job=job) as advance:
        slots = iter(sorted(set(range(total)) - writer.done))
        # Attempt k of slot i has seed i + k * total: an interrupted collection ends as a whole one.
        todo = [(slot, 0) for slot in slots]
        while todo:
            batch, todo = todo[:BATCH], todo[BATCH:]
            episodes = run_expert(task, scene, engine, [seeds[i + k * total] for i, k in batch])
            good = [demo for demo in episodes if demo is not None]
            unsteady += _unsteady(good, task, scene)
            for (slot, attempt), demo in zip(batch, episodes, strict=True):
                if demo is None or demo.seed in unsteady:
                    todo.append((slot, attempt + 1))
                    continue
                kept += 1
                writer.append(slot, replace(demo, cameras=cameras[slot]))
                advance()
            tried, succeeded = tried + len(batch), succeeded + len(good)
            outcome = f"The expert succeeded in {succeeded} of {tried} episodes"
            if unsteady:
                outcome += f"; those of seeds {unsteady} do not replay in every action space"
            if tried >= 20 and kept < LEAST_SUCCESS * tried:
                raise SimError(
                    f"{writer.part}: {outcome}. At least {LEAST_SUCCESS:.0%} of {task.name}'s "
                    "episodes should be worth keeping. What was collected is kept."
                )
    if console and tried:
        console.print(f"{outcome}{' and were replaced' * bool(unsteady)}.")


def _unsteady(demos: list[Demo], task: Task, scene: World) -> list[int]:
    """Seeds of the demonstrations that fail when replayed in one of the four action spaces."""
    if not demos:
        return []
    holds = np.all(list(replay_all(demos, task, scene).values()), 0)
    return [demo.seed for demo, held in zip(demos, holds, strict=True) if not held]


def run_expert(task: Task, scene: World, engine: Engine, seeds: list[int]) -> list[Demo | None]:
    """Runs one expert episode per seed, all at once.

    Returns:
        Demonstrations up to the expert's last aim, without cameras; None where it failed.
    """
    start = starts(task, scene, seeds)
    state = engine.reset(start)
    rngs = [task.rng(seed) for seed in seeds]
    each = (Start(*row) for row in zip(*start, strict=True))
    sights = [ExpertSight(*x) for x in zip(*_sensed(state), rngs, each, strict=True)]
    experts = [task.expert(scene, sight) for sight in sights]
    trace: list[State] = [state]
    commands: list[np.ndarray] = []
    errors: list[np.ndarray] = []
    lengths = np.full(len(seeds), task.horizon)
    while len(commands) < task.horizon:
        check_stop()
        aims = [next(expert, None) for expert in experts]
        for i, aim in enumerate(aims):
            if aim is None:
                lengths[i] = min(lengths[i], len(commands))
        running = lengths > len(commands)
        if not running.any():
            break
        command = np.stack([_command(aim) for aim in aims])
        state = engine.step(state, Command(command[:, :6], command[:, 6]), active=running)
        commands.append(command)
        errors.append(np.array([aim is not None and aim.error for aim in aims]))
        trace.append(state)
        for sight, position, rotation, qpos in zip(sights, *_sensed(state), strict=True):
            sight.grip_position, sight.grip_rotation, sight.qpos = position, rotation, qpos
    done = task.success(scene, trace[-1], start) & state.ok
    return [
        _demo(trace, commands, errors, start, i, seed, int(lengths[i])) if done[i] else None
        for i, seed in enumerate(seeds)
    ]


def _sensed(state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return state.grip_position, state.grip_rotation, state.qpos


def _command(aim: Aim | None) -> np.ndarray:
    if aim is None:  # finished: the world no longer moves
        return np.zeros(7)
    return np.concatenate([aim.position, rotvec_from_matrix(aim.rotation), [aim.gripper]])


def _demo(
    trace: list[State],
    commands: list[np.ndarray],
    errors: list[np.ndarray],
    start: Start,
    i: int,
    seed: int,
    length: int,
) -> Demo:
    states = trace[: length + 1]
    own = np.array([e[i] for e in errors[:length]])
    demo = Demo.record(
        Start(*(x[i] for x in start)),
        seed=seed,
        qpos=np.stack([s.qpos[i] for s in states]),
        qvel=np.stack([s.qvel[i] for s in states]),
        actions=np.stack([c[i] for c in commands[:length]]),
        grip_position=np.stack([s.grip_position[i] for s in states]),
        grip_rotation=np.stack([s.grip_rotation[i] for s in states]),
        gripper=np.array([s.closed[i] for s in states]),
    )
    return replace(demo, errors=own) if own.any() else demo


def main(config: CollectConfig, console: Console) -> None:
    """Runs the command."""
    demos = collect(config, console)
    lengths = [d.length for d in demos.episodes]
    console.print(
        f"{demos.path}: {len(demos.train)} training and {len(demos.valid)} validation "
        f"demonstrations of {min(lengths)} to {max(lengths)} control steps "
        f"(mean {np.mean(lengths):.0f}), {len(demos.header.world_from_camera)} cameras."
    )
