"""What a task is: its objects, how episodes start, when they succeed, and who shows how."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from jaxcam.rays import PoseRanges
from jaxcam.rays.rotations import Array
from jaxcam.sim.simulators import SIMULATORS, SimulatorName
from jaxcam.sim.types import Aim, ExpertSight, Start, State, Success
from jaxcam.sim.world import World

START_JOINT_NOISE = 0.02
"""Standard deviation (rad) of the arm's joint angles at the start: robosuite's and ManiSkill's
default."""
TABLE_SHIFT = 0.2
"""Half-range (m) of the table's shift against the robot in randomised scenes (authors' code)."""
ROOM_SHIFT = 2.0
"""Half-range (m) of the floor's shift against the robot in randomised scenes (authors' code)."""


class Task(ABC):
    """A manipulation task; one file in `jaxcam/sim/tasks` each.

    It names what it needs and never asks which engine runs it. What it says of itself loads no
    simulator; `scene` does. Functions of states use only the array namespace of their input, so
    they run on host and on device.
    """

    name: ClassVar[str]
    prompt: ClassVar[str]
    """The task in words, for policies that read; the authors'."""
    simulator: ClassVar[SimulatorName]
    """Where its worlds live."""
    horizon: ClassVar[int]
    """Control steps after which an episode has failed."""
    views: ClassVar[int]
    """Cameras that a policy sees at once (paper, section IV-A)."""
    stair: ClassVar[tuple[int, int]]
    """(n, m) of the stair-shaped camera schedule (paper, section IV-A)."""
    cameras: ClassVar[PoseRanges]
    """Where cameras are drawn from."""
    fovy_deg: ClassVar[float]
    """Vertical field of view of the task's cameras."""
    markers: ClassVar[tuple[str, ...]] = ()
    """Objects that are seen and never touched; their poses follow table and room in `fixtures`."""
    varied: ClassVar[tuple[str, ...]] = ()
    """Geoms of the physics model whose size differs between episodes."""

    @abstractmethod
    def objects(self) -> Sequence[Any]:
        """What is moved, in the terms of the task's simulator."""

    @abstractmethod
    def place(self, scene: World, rng: np.random.Generator, start: Start) -> None:
        """Draws an episode into the arrays of `start`: object poses, varied sizes, markers."""

    @abstractmethod
    def success(self, scene: World, state: State, start: Start) -> Array:
        """Whether the task is done in `state`, of episodes that began at `start`: bool [...]."""

    @abstractmethod
    def expert(self, scene: World, sight: ExpertSight) -> Iterator[Aim]:
        """Shows the task: yields an aim per control step, `sight` being renewed in between."""

    @abstractmethod
    def require(self) -> None:
        """Makes sure that this machine can run the task.

        Raises:
            SimError: If it cannot; the message says what is missing and how to get it.
        """

    def scene(self, name: str) -> World:
        """The task's world, `fixed` or `randomized`; made once a process.

        Raises:
            ConfigError: If there is no such scene.
        """
        return SIMULATORS[self.simulator].world(self, name)

    def success_in(self, scene: World) -> Success:
        """`success` in a world; what is returned twice for the same world is equal."""
        return _SuccessIn(self, scene)

    def rng(self, seed: int) -> np.random.Generator:
        """Random numbers for the expert of episode `seed`."""
        return np.random.default_rng([seed, 2])

    def start(self, scene: World, seed: int) -> Start:
        """The start of episode `seed`: objects, arm and, in randomised scenes, table and room.

        The same seed gives the same start whatever the batch, the policy and its training seed.
        Fixed and randomised scenes share the draws of objects and arm.
        """
        rng = np.random.default_rng([seed, 0])
        start = Start(
            qpos=scene.qpos0.copy(),
            geom_size=np.reshape([scene.size_of(name) for name in self.varied], (-1, 3)),
            fixtures=_shifted_fixtures(scene, len(self.markers), seed),
        )
        start.qpos[scene.arm] = scene.home + START_JOINT_NOISE * rng.standard_normal(7)
        self.place(scene, rng, start)
        return start


@dataclass(frozen=True)
class _SuccessIn:
    """A task's success in one world. Compiled programs are known by it: equal for equal parts."""

    task: Task
    scene: World

    def __call__(self, state: State, start: Start) -> Array:
        return self.task.success(self.scene, state, start)


def _shifted_fixtures(scene: World, markers: int, seed: int) -> np.ndarray:
    """Poses (xyz, wxyz) [2 + markers, 7] of table, room and markers at the start of an episode.

    In randomised scenes table and room are moved by up to a half-range and turned; markers are at
    the origin, for `Task.place` to put somewhere.
    """
    rng = np.random.default_rng([seed, 1])
    poses = np.zeros((2 + markers, 7))
    poses[:, 3] = 1
    if scene.name == "randomized":
        for pose, reach in zip(poses[:2], (TABLE_SHIFT, ROOM_SHIFT), strict=True):
            pose[:2] = rng.uniform(-reach, reach, 2)
            yaw = rng.uniform(-np.pi, np.pi)
            pose[3], pose[6] = np.cos(yaw / 2), np.sin(yaw / 2)
    poses[0, 2] = scene.table_middle
    return poses


def starts(task: Task, scene: World, seeds: range | list[int]) -> Start:
    """The starts of several episodes, stacked."""
    each = [task.start(scene, seed) for seed in seeds]
    return Start(*(np.stack(x) for x in zip(*each, strict=True)))
