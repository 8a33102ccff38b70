"""`python -m jaxcam.robomimic FILE`: robomimic's demonstrations of robosuite as a jaxcam dataset.

The simulator states in the file are carried over to the task's scene, joint by joint, and its
actions become absolute targets; cameras are drawn as for our own demonstrations. What comes out
trains as a collected dataset does: `python -m jaxcam.train --dataset`.
"""

import contextlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from rich.console import Console

from jaxcam.config.datasets import RobomimicConfig
from jaxcam.config.names import TaskName
from jaxcam.console.progress import progress
from jaxcam.data.demos import Demo, Demos
from jaxcam.data.hdf5 import open_hdf5, whole
from jaxcam.data.replay import replay_all
from jaxcam.data.splits import FIRST_SEED
from jaxcam.errors import ConfigError, DatasetError, closest
from jaxcam.files.paths import home
from jaxcam.interop.importing import succeeds, write_dataset
from jaxcam.interop.robosuite_model import (
    Controller,
    Origin,
    grip_poses,
    read_controller,
    read_origin,
)
from jaxcam.rays.rotations import rotvec_from_matrix
from jaxcam.sim import make_task
from jaxcam.sim.controllers import CONTROL_HZ, gripper_command
from jaxcam.sim.mujoco.scene import Scene
from jaxcam.sim.task import Task
from jaxcam.sim.types import Start

ENVIRONMENTS: dict[str, TaskName] = {"Lift": "lift", "LiftRand": "lift"}
"""Our task of each of robosuite's environments that can be replayed."""
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
    about: str
    """Where the demonstrations come from, for the header."""

    def demo(self, name: str, task: Task, scene: Scene, seed: int) -> Demo:
        """One demonstration, without cameras; names file and demonstration in errors."""
        data: Any = self.file["data"]
        group = data[name]
        try:
            states = group["states"][:]
            xml = str(group.attrs["model_file"])
            actions = np.asarray(group["actions"]) if "actions" in group else None
            return _convert(states, actions, xml, self.controller, task, scene, seed)
        except KeyError as error:
            raise DatasetError(
                f"{self.path}: data/{name}: no {error.args[0]!r}. A replay needs the simulator's "
                "states and the model_file attribute: use the file as robomimic hosts it "
                "(low_dim or demo), not one reduced to observations."
            ) from error
        except DatasetError as error:
            raise DatasetError(f"{self.path}: data/{name}: {error}") from error
        except (OSError, RuntimeError) as error:
            raise DatasetError(f"{self.path}: data/{name}: damaged ({error}). {REMEDY}") from error


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
    with _source(config) as source:
        names = source.train + source.valid
        with progress(console, "importing", len(names)) as advance:

            def converted() -> Iterator[Demo]:
                for i, name in enumerate(names):
                    yield source.demo(name, task, scene, FIRST_SEED + i)
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
    with open_hdf5(path, remedy=REMEDY) as file, whole(path, REMEDY):
        name, _ = _environment(path, file)
    return ENVIRONMENTS.get(name, RobomimicConfig.task)


@contextlib.contextmanager
def _source(config: RobomimicConfig) -> Iterator[DemonstrationFile]:
    path = home(config.file)
    with open_hdf5(path, remedy=REMEDY) as file:
        with whole(path, REMEDY):
            source = _read_source(path, file, config)
        yield source


def _environment(path: Path, file: h5py.File) -> tuple[str, dict[str, Any]]:
    """Name of the environment that a file was recorded in, and what env_args says of it."""
    data: Any = file.get("data")
    try:
        env = json.loads(data.attrs["env_args"])
        name, _ = str(env["env_name"]), dict(env.get("env_kwargs", {}))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise DatasetError(
            f"{path}: not in robomimic's layout: no attribute env_args (JSON) on group data; found "
            f"{sorted(file)}. robosuite's own recordings are turned into it by robomimic's "
            "convert_robosuite.py."
        ) from error
    return name, env


def _read_source(path: Path, file: h5py.File, config: RobomimicConfig) -> DemonstrationFile:
    name, env = _environment(path, file)
    settings = dict(env.get("env_kwargs", {}))
    _check_environment(path, name, settings, config.task)
    controller = None
    if config.actions == "commands":
        try:
            controller = read_controller(settings.get("controller_configs") or {})
        except DatasetError as error:
            raise DatasetError(f"{path}: {error} Import with --actions states.") from error
    train, valid = _split(path, file, config)
    version = env.get("env_version", "of unknown version")
    about = f"{path.name}: {name} of robosuite {version}, {config.actions}"
    return DemonstrationFile(path, file, controller, train, valid, about)


def _check_environment(path: Path, name: str, settings: dict[str, Any], task: str) -> None:
    if ENVIRONMENTS.get(name) != task:
        if reason := OTHERS.get(name):
            raise DatasetError(f"{path}: {name} cannot be replayed in our tasks: {reason}.")
        if name in ENVIRONMENTS:
            fix = f"Import it with --task {ENVIRONMENTS[name]}."
        else:
            fix = f"Environments that can be imported: {', '.join(ENVIRONMENTS)}."
        raise DatasetError(f"{path}: demonstrations of {name}, but task {task!r} was asked. {fix}")
    hz = settings.get("control_freq", CONTROL_HZ)
    if hz != CONTROL_HZ:
        raise DatasetError(
            f"{path}: recorded at {hz} control steps a second; ours take {CONTROL_HZ}."
        )


def _split(path: Path, file: h5py.File, config: RobomimicConfig) -> tuple[list[str], list[str]]:
    """Names of the training and of the validation demonstrations."""
    names = _numbered(file)
    if config.filter_key is not None:
        members = _members(path, file, config.filter_key)
        names = [n for n in names if n in members]
    masks: Any = file.get("mask", {})
    if config.validation is None and "valid" in masks:
        members = _members(path, file, "valid")
        valid = [n for n in names if n in members]
    else:
        count = len(names) // 10 if config.validation is None else config.validation
        valid = names[max(len(names) - count, 0) :]
    train = [n for n in names if n not in valid]
    if not train:
        raise DatasetError(
            f"{path}: {len(names)} demonstrations, {len(valid)} of them for validation: none is "
            "left to train on. Choose another --filter-key or a smaller --validation."
        )
    return train, valid


def _numbered(file: h5py.File) -> list[str]:
    """Names of the file's demonstrations, by their number."""
    data: Any = file["data"]
    names = [name for name in data if name.removeprefix("demo_").isdigit()]
    return sorted(names, key=lambda name: int(name.removeprefix("demo_")))


def _members(path: Path, file: h5py.File, mask: str) -> set[str]:
    """Names of the demonstrations that an entry of the file's `mask` lists."""
    masks: Any = file.get("mask", {})
    if mask not in masks:
        raise DatasetError(f"{path}: no filter key {mask!r}{closest(mask, masks)}")
    return {n.decode() if isinstance(n, bytes) else str(n) for n in masks[mask][:]}


def _convert(
    states: np.ndarray,
    actions: np.ndarray | None,
    xml: str,
    controller: Controller | None,
    task: Task,
    scene: Scene,
    seed: int,
) -> Demo:
    """A recorded episode in our scene: T states give T - 1 control steps."""
    if states.ndim != 2 or len(states) < 2 or not np.isfinite(states).all():
        raise DatasetError(f"states {states.shape}: two or more rows of finite numbers are needed.")
    if actions is not None and actions.shape != (len(states), 7):
        raise DatasetError(f"actions {actions.shape}, expected {(len(states), 7)}: one per state.")
    origin = read_origin(xml, states[0], scene, task.varied)
    qpos, qvel = origin.carry(states)
    position, rotation = grip_poses(scene, qpos)
    gripper = _gripper(qpos[:, scene.fingers], actions)
    targets = _targets(controller, actions, origin, position, rotation)
    closed = [0.0]
    for sign in gripper:
        closed.append(float(gripper_command(np.array(closed[-1]), sign)))
    return Demo.record(
        Start(qpos[0], origin.geom_size, task.start(scene, seed).fixtures),
        seed=seed,
        qpos=qpos,
        qvel=qvel,
        actions=np.column_stack([targets, gripper]),
        grip_position=position,
        grip_rotation=rotation,
        gripper=np.array(closed),
    )


def _targets(
    controller: Controller | None,
    actions: np.ndarray | None,
    origin: Origin,
    position: np.ndarray,
    rotation: np.ndarray,
) -> np.ndarray:
    """Absolute grip targets of all states but the last [T - 1, 6]."""
    if controller is None:
        ahead = np.minimum(np.arange(len(position) - 1) + LEAD, len(position) - 1)
        return np.concatenate([position, rotvec_from_matrix(rotation)], -1)[ahead]
    if actions is None:
        raise DatasetError("no 'actions'. Import with --actions states.")
    return controller.targets(actions[:, :6], origin, position, rotation)[:-1]


def _gripper(fingers: np.ndarray, actions: np.ndarray | None) -> np.ndarray:
    """Signs of the gripper's command of all states but the last; from the opening if need be."""
    if actions is not None:
        return np.sign(actions[:-1, 6])
    moves = np.diff(np.abs(fingers).sum(-1))
    signs, last = np.empty(len(moves)), -1.0
    for t, move in enumerate(moves):
        if abs(move) > STILL:
            last = -float(np.sign(move))
        signs[t] = last
    return signs


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


def main(config: RobomimicConfig, console: Console) -> None:
    """Runs the command."""
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
    console.print(f"Train on it: python -m jaxcam.train --dataset {demos.path}", soft_wrap=True)
