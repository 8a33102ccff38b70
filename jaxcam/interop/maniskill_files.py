"""ManiSkill's trajectory files: HDF5 with environment states, and JSON beside it.

The layout is that of ManiSkill's `RecordEpisode` (mani_skill 3), which the official demonstrations
share::

    traj_<i>/actions                              [T, A]
    traj_<i>/success                              [T]
    traj_<i>/env_states/actors/<name>             [T + 1, 13]  pose (xyz, wxyz), velocities
    traj_<i>/env_states/articulations/<robot>     [T + 1, 31]  the root's, joints, speeds
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from jaxcam.config.datasets import ManiskillConfig
from jaxcam.data.demos import Demo
from jaxcam.data.hdf5 import (
    array_at,
    check_total,
    group_at,
    numbers,
    open_hdf5,
    reading,
    require_file,
)
from jaxcam.errors import DatasetError, JaxcamError, closest
from jaxcam.files.paths import home
from jaxcam.interop.maniskill_actions import (
    check_mode,
    grip_targets,
    gripper_signs,
)
from jaxcam.rays.rotations import quaternion_from_matrix, rotvec_from_matrix
from jaxcam.sim import make_task
from jaxcam.sim.controllers import CONTROL_HZ
from jaxcam.sim.maniskill import kinematics
from jaxcam.sim.maniskill.memory import JOINTS
from jaxcam.sim.maniskill.scene import SapienWorld
from jaxcam.sim.maniskill.task import ManiSkillTask
from jaxcam.sim.types import Start

ENVIRONMENTS = {
    "PushCube-v1": "push",
    "PushCubeRand-v1": "push",
    "JaxcamPush-v1": "push",
    "LiftPegUpright-v1": "lift_upright",
    "LiftPegUprightRand-v1": "lift_upright",
    "JaxcamLiftUpright-v1": "lift_upright",
    "RollBall-v1": "roll_ball",
    "RollBallRand-v1": "roll_ball",
    "JaxcamRollBall-v1": "roll_ball",
}
"""Our task of each environment whose trajectories can be replayed: ManiSkill's own, the authors'
variants, ours."""
ROOT, POSE = 13, 7
"""Lengths of what stands before the joints in an articulation's state (pose and velocities of its
root), and of the pose in an actor's, before its velocities."""
REMEDY = "Download or record it again."
"""What to do with a file that is damaged."""
LARGEST_JSON = 1 << 26
"""Bytes of the JSON file: a thousand episodes have 1 MB."""
TYPO = 0.85
"""Likeness of an environment's name from which one of ours was meant: PickCube is not PushCube."""
SAME = 1e-3
"""Difference (m, and of quaternions) up to which two poses of the robot's base are the same."""


@dataclass(frozen=True)
class ManiskillEpisode:
    """A trajectory, as the JSON file lists it."""

    name: str
    """Of its group in the HDF5 file."""
    mode: str
    """Control mode that it was recorded in."""


@dataclass(frozen=True)
class TrajectoryFile:
    """A trajectory file and what is known of it."""

    path: Path
    env: str
    task: ManiSkillTask
    scene: SapienWorld
    episodes: list[ManiskillEpisode]
    about: str
    """Where the demonstrations come from, for the header."""


def read_source(config: ManiskillConfig) -> TrajectoryFile:
    """What a file and the JSON beside it say of themselves.

    Raises:
        DatasetError: If they are missing, not ManiSkill's, or of a task that we have not.
    """
    path = home(config.file)
    require_file(path)
    about = path.with_suffix(".json")
    require_file(
        about,
        "no such file. ManiSkill writes it beside the trajectories; without it their task is not "
        "known.",
    )
    if about.stat().st_size > LARGEST_JSON:
        raise DatasetError(f"{about}: {about.stat().st_size} bytes; expected a list of episodes.")
    try:
        said = json.loads(about.read_text())
        env, listed = str(said["env_info"]["env_id"]), list(said["episodes"])
        settings = dict(said["env_info"].get("env_kwargs") or {})
        hz = dict(settings.get("sim_config") or {}).get("control_freq", CONTROL_HZ)
    except OSError as error:
        raise DatasetError(f"{about}: cannot be read: {error.strerror or error}.") from error
    except (AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise DatasetError(
            f"{about}: not what ManiSkill writes beside trajectories. Expected env_info with "
            "env_id, and episodes."
        ) from error
    if env not in ENVIRONMENTS:
        raise DatasetError(
            f"{path}: trajectories of {env!r}{closest(env, ENVIRONMENTS, TYPO)}. Others cannot be "
            "replayed in our tasks."
        )
    if hz != CONTROL_HZ:
        raise DatasetError(
            f"{path}: recorded at {hz} control steps a second; ours take {CONTROL_HZ}."
        )
    if not listed:
        raise DatasetError(f"{about}: no episodes.")
    episodes = [_episode(about, i, entry) for i, entry in enumerate(listed)]
    task: Any = make_task(ENVIRONMENTS[env])
    source = str(said.get("source_type") or "unknown source")[:40]
    return TrajectoryFile(
        path, env, task, task.scene(config.scene), episodes, f"{path.name}: {env}, {source}"
    )


def _episode(about: Path, index: int, entry: Any) -> ManiskillEpisode:
    """An entry of the JSON file's episodes."""
    entry = entry if isinstance(entry, dict) else {}
    number, mode = entry.get("episode_id"), entry.get("control_mode")
    where = f"{about}: episodes[{index}]"
    if not isinstance(number, int) or isinstance(number, bool) or number < 0:
        raise DatasetError(f"{where}: episode_id {number!r}; expected a whole number.")
    if not isinstance(mode, str):
        raise DatasetError(
            f"{where} (traj_{number}): control_mode {mode!r}; expected its name. Without it "
            "nobody knows what the actions mean."
        )
    try:
        check_mode(mode)
    except DatasetError as error:
        raise DatasetError(f"{where} (traj_{number}): {error}") from error
    return ManiskillEpisode(f"traj_{number}", mode)


def open_file(path: Path) -> h5py.File:
    """Opens the HDF5 file.

    Raises:
        DatasetError: If it cannot be.
    """
    return open_hdf5(path, remedy=REMEDY)


def check_file_size(source: TrajectoryFile, file: h5py.File) -> None:
    """Refuses more numbers than the file can hold, before any is read.

    Raises:
        DatasetError: They are more.
    """
    declared = 0

    def add(_: str, array: Any) -> None:
        nonlocal declared
        declared += array.nbytes if isinstance(array, h5py.Dataset) else 0

    with reading(source.path, REMEDY):
        for episode in source.episodes:
            if isinstance(group := file.get(episode.name), h5py.Group):
                for part in ("env_states", "actions"):
                    if isinstance(within := group.get(part), h5py.Group):
                        within.visititems(add)
                    else:
                        add(part, within)
        check_total(source.path, declared)


def read_demo(source: TrajectoryFile, file: h5py.File, name: str, mode: str, seed: int) -> Demo:
    """One trajectory as a demonstration, without cameras.

    Args:
        source: The file.
        file: The same, open.
        name: Of the trajectory.
        mode: Control mode it was recorded in.
        seed: Of the demonstration; fixes where the table is seen.

    Raises:
        DatasetError: If something is missing or wrong; names file and trajectory.
    """
    try:
        with reading(source.path, REMEDY, name):
            missing = [part for part in (name, f"{name}/env_states", f"{name}/actions")
                       if part not in file]  # fmt: skip
            if missing:
                raise DatasetError(
                    f"no {missing[0]!r}. A replay needs all trajectories of the .json file, with "
                    "actions and environment states (RecordEpisode's record_env_state); a file "
                    "without states is given them by mani_skill.trajectory.replay_trajectory."
                )
            group = group_at(file, name)
            states = group_at(group, "env_states")
            return _convert(source, states, numbers(group, "actions"), mode, seed)
    except JaxcamError as error:
        if str(error).startswith(f"{source.path}: "):
            raise
        raise DatasetError(f"{source.path}: {name}: {error}") from error


def _convert(
    source: TrajectoryFile, states: Any, actions: np.ndarray, mode: str, seed: int
) -> Demo:
    """A recorded episode in our world: T actions and T + 1 states."""
    scene, task = source.scene, source.task
    robot = _robot(group_at(states, "articulations"))
    _check_base(robot[0], scene.world_from_base)
    joints, joint_speeds = robot[:, ROOT : ROOT + JOINTS], robot[:, ROOT + JOINTS :]
    everything = group_at(states, "actors")
    actors = [_actor(everything, name, len(robot)) for name in scene.objects]
    qpos = np.concatenate([joints, *(actor[:, :POSE] for actor in actors)], -1)
    qvel = np.concatenate([joint_speeds, *(actor[:, POSE:] for actor in actors)], -1)
    if len(actions) < 1 or actions.ndim != 2 or len(qpos) != len(actions) + 1:
        raise DatasetError(
            f"actions {actions.shape} and {len(qpos)} states: there must be one state more."
        )
    if not (np.isfinite(qpos).all() and np.isfinite(qvel).all() and np.isfinite(actions).all()):
        raise DatasetError("states or actions that are not finite numbers.")
    fixtures = task.start(scene, seed).fixtures
    for row, name in enumerate(scene.markers, start=2):
        fixtures[row] = _actor(everything, name, len(robot))[0, :POSE]
    position, rotation, _ = kinematics.forward(joints[:, :7])
    targets = grip_targets(mode, actions, joints[:, :7])
    position, rotation = _in_world(scene, position, rotation)
    aim, aim_rotation = _in_world(scene, *targets)
    gripper = gripper_signs(actions)
    return Demo.record(
        Start(qpos[0], np.zeros((0, 3)), fixtures),
        seed=seed,
        qpos=qpos,
        qvel=qvel,
        actions=np.column_stack([aim, rotvec_from_matrix(aim_rotation), gripper]),
        grip_position=position,
        grip_rotation=rotation,
        gripper=np.concatenate([[-1.0], gripper]),
    )


def why_failed(source: TrajectoryFile, file: Any, name: str) -> str:
    """Why a trajectory reaches success in none of its states."""
    flags = numbers(file[name], "success") if "success" in file[name] else np.zeros(1)
    if not flags.any():
        return "failed when it was recorded"
    return (
        f"a success for {source.env}, but in no recorded state for {source.task.name}: "
        f"{type(source.task).success.__doc__}"
    )


def _robot(articulations: h5py.Group) -> np.ndarray:
    """States [T + 1, 31] of the Panda."""
    names = [name for name in articulations if str(name).startswith("panda")]
    size = ROOT + 2 * JOINTS
    if len(names) != 1 or array_at(articulations, str(names[0])).shape[1:] != (size,):
        shapes = {str(name): array_at(articulations, str(name)).shape for name in articulations}
        raise DatasetError(f"robots {shapes}, expected one Panda with states [T + 1, {size}].")
    return numbers(articulations, str(names[0]))


def _actor(actors: h5py.Group, name: str, count: int) -> np.ndarray:
    """Poses and velocities of an object [T + 1, 13]."""
    states = numbers(actors, name)
    if states.shape != (count, ROOT):
        raise DatasetError(f"actor {name!r} has states {states.shape}, expected {(count, ROOT)}.")
    return states


def _check_base(state: np.ndarray, world_from_base: np.ndarray) -> None:
    """That the robot stands where it does in our world."""
    wanted = np.concatenate(
        [world_from_base[:3, 3], quaternion_from_matrix(world_from_base[:3, :3])]
    )
    base = state[:POSE] * np.where(np.arange(POSE) < 3, 1, np.sign(state[3:POSE] @ wanted[3:]))
    if abs(base - wanted).max() > SAME:
        raise DatasetError(
            f"the robot's base is at {base.round(3).tolist()} (xyz, wxyz), in our task at "
            f"{wanted.round(3).tolist()}."
        )


def _in_world(
    scene: SapienWorld, position: np.ndarray, rotation: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    base = scene.world_from_base
    return position @ base[:3, :3].T + base[:3, 3], base[:3, :3] @ rotation
