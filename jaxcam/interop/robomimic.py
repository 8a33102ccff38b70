"""`python -m jaxcam.robomimic FILE`: robomimic's demonstrations of robosuite as a jaxcam dataset.

The simulator states in the file are carried over to the task's scene, joint by joint, and its
actions become absolute targets; cameras are drawn as for our own demonstrations. What comes out
trains as a collected dataset does: `python -m jaxcam.train --dataset`.
"""

import contextlib
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from rich.console import Console

from jaxcam.config.datasets import RobomimicConfig
from jaxcam.config.names import TaskName
from jaxcam.console.progress import progress
from jaxcam.data.demos import Demo, Demos
from jaxcam.data.hdf5 import (
    array_at,
    check_total,
    group_at,
    numbers,
    open_hdf5,
    reading,
    text,
)
from jaxcam.data.replay import falls_short, replay_all
from jaxcam.data.splits import FIRST_SEED
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.files.paths import home
from jaxcam.interop.importing import Masks, show_next, succeeds, write_dataset
from jaxcam.interop.robosuite_commands import (
    Controller,
    disagreement,
    read_controller,
)
from jaxcam.interop.robosuite_model import ObjectNames, Origin, grip_path, read_origin
from jaxcam.interop.robosuite_witness import FINGERS_STRAY, Witness, closedness
from jaxcam.rays.rotations import rotvec_from_matrix
from jaxcam.sim import make_engine, make_task
from jaxcam.sim.controllers import CONTROL_HZ
from jaxcam.sim.engine import Engine
from jaxcam.sim.mujoco.scene import FIXTURES, Scene
from jaxcam.sim.task import Task
from jaxcam.sim.types import Start

_SHEETS = {0: "plane", 1: "floor_plane"}
"""What the authors show of table and room: sheets that are moved in every episode."""


class Environment(NamedTuple):
    """One of robosuite's environments that can be replayed."""

    task: TaskName
    """Ours."""
    names: ObjectNames = ObjectNames()
    """What it calls things."""


ENVIRONMENTS = {
    "Lift": Environment("lift"),
    "LiftRand": Environment("lift", ObjectNames(shown=_SHEETS)),
    "CanRand": Environment(
        "pick_place_can", ObjectNames({"can": "Can"}, {**_SHEETS, 2: "VisualCan"})
    ),
    "SquareRand": Environment(
        "square", ObjectNames({"nut": "Square", "peg": "Peg"}, {**_SHEETS, 0: "table_plane"})
    ),
}
"""By robosuite's names; those that end in Rand are the paper's authors'."""
OTHERS = {
    "PickPlaceCan": "its can goes from one bin into another; ours stands on a plain table and goes "
    "to a ghost",
    "NutAssemblySquare": "its pegs are fixed to another table; ours is free and of another size",
}
"""Environments that are like one of our tasks, and why their states mean nothing there."""
STILL = 1e-4
"""Change of the fingers' opening (m) in a control step below which they hold."""
REMEDY = "Download it again."
"""What to do with a file that is damaged."""
LEAD = 4
"""Control steps by which the pose that becomes a command lies ahead where only states are known:
the controller follows 2 / sqrt(150) s behind, 3.3 steps, so the next step's pose would be late. Of
1 to 5, 4 came closest to the recorded ways (80 episodes of robosuite 1.4.1 and 1.5.2)."""


@dataclass(frozen=True)
class DemonstrationFile:
    """A robomimic file, open."""

    path: Path
    file: h5py.File
    controller: Controller | None
    """None where commands come from states."""
    train: list[str]
    valid: list[str]
    count: int
    """Demonstrations that the file has."""
    about: str
    """Where the demonstrations come from, for the header."""
    names: ObjectNames
    """What its world calls things."""

    def demo(self, name: str, task: Task, engine: Engine, seed: int) -> Demo:
        """One demonstration, without cameras; names file and demonstration in errors."""
        where = f"data/{name}"
        try:
            with reading(self.path, REMEDY, where):
                group = group_at(group_at(self.file, "data"), name)
                if "states" not in group or "model_file" not in group.attrs:
                    missing = "model_file" if "states" in group else "states"
                    raise DatasetError(
                        f"no {missing!r}. A replay needs the simulator's states and the "
                        "model_file attribute: use the file as robomimic hosts it (low_dim or "
                        "demo), not one reduced to observations."
                    )
                states = numbers(group, "states")
                actions = numbers(group, "actions") if "actions" in group else None
                xml = text(group, "model_file")
            recorded = _Recorded(states, actions, xml, self.names)
            return _convert(recorded, self.controller, task, engine, seed)
        except DatasetError as error:
            if str(error).startswith(f"{self.path}: "):
                raise
            raise DatasetError(f"{self.path}: {where}: {error}") from error


def import_demos(config: RobomimicConfig, console: Console | None = None) -> Demos:
    """Turns a robomimic file into a dataset of ours.

    Args:
        config: What to import and how.
        console: For progress; silent when None.

    Returns:
        The dataset as read back.

    Raises:
        DatasetError: If the file is not robomimic's, is of another task or robot, or if the
            dataset exists.
    """
    task = make_task(config.task)
    scene = task.scene(config.scene)
    if not isinstance(scene, Scene):
        raise ConfigError(f"{config.task} is not one of robosuite's tasks, but the file is of one.")
    engine = make_engine(None, scene, "osc_pose", task.varied)
    with _source(config) as source:
        names = source.train + source.valid
        if console and config.filter_key is None and len(names) < source.count:
            console.print(
                f"{source.path}: {source.count - len(names)} of {source.count} demonstrations are "
                "neither in mask/train nor in mask/valid: they are left out."
            )
        with progress(console, "importing", len(names)) as advance:

            def converted() -> Iterator[Demo]:
                for i, name in enumerate(names):
                    yield source.demo(name, task, engine, FIRST_SEED + i)
                    advance()

            return write_dataset(
                config,
                task,
                converted(),
                train=len(source.train),
                valid=len(source.valid),
                about=source.about,
                console=console,
            )


def task_of(path: Path) -> TaskName:
    """Our task of a robomimic file; one that the import refuses with the reason if there is none.

    Raises:
        DatasetError: The file cannot be read.
    """
    with open_hdf5(path, remedy=REMEDY) as file, reading(path, REMEDY):
        name, _ = _environment(path, file)
    known = ENVIRONMENTS.get(name)
    return known.task if known else RobomimicConfig.task


@contextlib.contextmanager
def _source(config: RobomimicConfig) -> Iterator[DemonstrationFile]:
    path = home(config.file)
    with open_hdf5(path, remedy=REMEDY) as file:
        with reading(path, REMEDY):
            source = _read_source(path, file, config)
        yield source


def _environment(path: Path, file: h5py.File) -> tuple[str, dict[str, Any]]:
    """Name of the environment that a file was recorded in, and what env_args says of it."""
    data = file.get("data")
    try:
        if not isinstance(data, h5py.Group):
            raise TypeError("no group data")
        env = json.loads(text(data, "env_args"))
        name, _ = str(env["env_name"]), dict(env.get("env_kwargs") or {})
    except (AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise DatasetError(
            f"{path}: not in robomimic's layout: no attribute env_args (JSON) on group data; found "
            f"{sorted(file)[:20]}. robosuite's own recordings are turned into it by robomimic's "
            "convert_robosuite.py."
        ) from error
    return name, env


def _read_source(path: Path, file: h5py.File, config: RobomimicConfig) -> DemonstrationFile:
    name, env = _environment(path, file)
    settings = dict(env.get("env_kwargs") or {})
    _check_environment(path, name, settings, config.task)
    controller, version = None, str(env.get("env_version", "of unknown version"))[:40]
    if config.actions != "states":
        try:
            controller = read_controller(
                settings.get("controller_configs"), config.actions, version
            )
        except DatasetError as error:
            raise DatasetError(f"{path}: {error} Import with --actions states.") from error
    everything = _numbered(file)
    train, valid = Masks.of(path, file, everything).split(config.filter_key, config.validation)
    about = f"{path.name}: {name} of robosuite {version}, {config.actions}"
    _check_sizes(path, file, train + valid)
    names = ENVIRONMENTS[name].names
    return DemonstrationFile(path, file, controller, train, valid, len(everything), about, names)


def _check_sizes(path: Path, file: h5py.File, demos: list[str]) -> None:
    """Refuses more numbers than the file can hold, before any is read."""
    data = group_at(file, "data")
    groups = [group_at(data, name) for name in demos]
    arrays = [(group, name) for group in groups for name in ("states", "actions") if name in group]
    check_total(path, sum(array_at(group, name).nbytes for group, name in arrays))


def _check_environment(path: Path, name: str, settings: dict[str, Any], task: str) -> None:
    known = ENVIRONMENTS.get(name)
    if known is None or known.task != task:
        if reason := OTHERS.get(name):
            raise DatasetError(f"{path}: {name} cannot be replayed in our tasks: {reason}.")
        if known:
            fix = f"Import it with --task {known.task}."
        else:
            fix = f"Environments that can be imported: {', '.join(ENVIRONMENTS)}."
        raise DatasetError(f"{path}: demonstrations of {name}, but task {task!r} was asked. {fix}")
    hz = settings.get("control_freq", CONTROL_HZ)
    if hz != CONTROL_HZ:
        raise DatasetError(
            f"{path}: recorded at {hz!r:.40} control steps a second; ours take {CONTROL_HZ}."
        )


def _numbered(file: h5py.File) -> list[str]:
    """Names of the file's demonstrations, by their number."""
    everything = map(str, group_at(file, "data"))
    numbered = [name for name in everything if re.fullmatch("demo_[0-9]{1,9}", name)]
    return sorted(numbered, key=lambda name: int(name.removeprefix("demo_")))


class _Recorded(NamedTuple):
    """An episode as the file has it."""

    states: np.ndarray
    actions: np.ndarray | None
    xml: str
    names: ObjectNames


def _convert(
    recorded: _Recorded, controller: Controller | None, task: Task, engine: Engine, seed: int
) -> Demo:
    """A recorded episode in our scene: T states give T - 1 control steps."""
    states, actions, xml, names = recorded
    if states.ndim != 2 or len(states) < 2 or not np.isfinite(states).all():
        raise DatasetError(f"states {states.shape}: two or more rows of finite numbers are needed.")
    sizes = (7,) if controller else (7, 8)  # of joints only the gripper's command is of use
    if actions is not None and actions.shape not in [(len(states), size) for size in sizes]:
        raise DatasetError(f"actions {actions.shape}, expected {(len(states), 7)}: one per state.")
    if actions is not None and not np.isfinite(actions).all():
        raise DatasetError("actions that are not finite numbers.")
    scene: Scene = engine.scene
    origin = read_origin(xml, states[0], scene, task.varied, names)
    qpos, qvel = origin.carry(states)
    path = grip_path(scene, qpos)
    witness = Witness(engine, qpos, qvel, path, origin.geom_size)
    witness.check_pace()
    if controller is not None:
        targets, signs = _commanded(controller, actions, origin, witness)
    else:
        targets, signs = _followed(actions, witness)
    usual = task.start(scene, seed).fixtures
    moved = range(0 if scene.name == "randomized" else len(FIXTURES), len(usual))
    return Demo.record(
        Start(qpos[0], origin.geom_size, origin.fixtures(states[0], usual, moved)),
        seed=seed,
        qpos=qpos,
        qvel=qvel,
        actions=np.column_stack([targets, signs]),
        grip_position=path.position,
        grip_rotation=path.rotation,
        gripper=closedness(signs),
    )


def _commanded(
    controller: Controller, actions: np.ndarray | None, origin: Origin, witness: Witness
) -> tuple[np.ndarray, np.ndarray]:
    """Grip targets [T - 1, 6] and gripper signs [T - 1] that the file's actions ask for."""
    if actions is None:
        raise DatasetError("no 'actions'. Import with --actions states.")
    signs = np.sign(actions[:-1, 6])
    if doubt := disagreement(controller, actions[:, :6], signs, origin, witness):
        raise DatasetError(doubt)
    return controller.targets(actions[:, :6], origin, witness.path)[:-1], signs


def _followed(actions: np.ndarray | None, witness: Witness) -> tuple[np.ndarray, np.ndarray]:
    """Grip targets [T - 1, 6] and gripper signs [T - 1] that lead where the states go.

    Signs are those of the actions if the fingers follow them, else they come from the fingers.
    """
    path, last = witness.path, len(witness.qpos) - 1
    ahead = np.minimum(np.arange(last) + LEAD, last)
    targets = np.concatenate([path.position, rotvec_from_matrix(path.rotation)], -1)[ahead]
    if actions is not None:
        signs = np.sign(actions[:-1, -1])
        if witness.missed(targets, signs).fingers <= FINGERS_STRAY:
            return targets, signs
    opening = np.abs(witness.qpos[:, witness.engine.scene.fingers]).sum(-1)
    signs, sign = np.empty(last), -1.0
    for t, move in enumerate(np.diff(opening)):
        if abs(move) > STILL:
            sign = -float(np.sign(move))
        signs[t] = sign
    return targets, signs


def success_of(demos: Demos, console: Console | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Whether each demonstration succeeds in its recorded states, and when replayed, bool [D].

    Args:
        demos: An imported dataset.
        console: For progress; silent when None.
    """
    task, world, episodes = demos.task, demos.world, demos.episodes
    recorded = np.array([succeeds(demo, task, world) for demo in episodes])
    with progress(console, "replaying", len(episodes)) as advance:
        replayed = replay_all(episodes, task, world, ("eef_abs",), tick=advance)["eef_abs"]
    return recorded, replayed


def main(config: RobomimicConfig, console: Console) -> int:
    """Runs the command; its exit code."""
    demos = import_demos(config, console)
    recorded, replayed = success_of(demos, console)
    console.print(
        f"{demos.path}: {len(demos.train)} training and {len(demos.valid)} validation "
        f"demonstrations. {recorded.sum()} of {len(recorded)} succeed as recorded, "
        f"{replayed.sum()} when their commands are replayed here."
    )
    failed = ", ".join(f"demo_{i}" for i in np.flatnonzero(~replayed))
    if failed:
        console.print(f"Not replayed to success (numbers of the new file): {failed}")
    show_next(demos, bool(replayed.any()), console)
    return int(falls_short({"eef_abs": replayed}))
