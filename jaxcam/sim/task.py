"""What a task is: its objects, how episodes start, when they succeed, and who shows how."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from jaxcam.rays import PoseRanges
from jaxcam.rays.rotations import Array
from jaxcam.sim.engine import Start, State
from jaxcam.sim.world import World

START_JOINT_NOISE = 0.02
"""Standard deviation (rad) of the arm's joint angles at the start: robosuite's and ManiSkill's
default."""


@dataclass
class Sight:
    """What an expert sees of its world before each control step (world frame, metres)."""

    grip_position: np.ndarray
    grip_rotation: np.ndarray
    qpos: np.ndarray
    rng: np.random.Generator
    """The episode's own, for what an expert does by chance."""
    start: Start
    """How the episode began."""


@dataclass(frozen=True)
class Aim:
    """What an expert wants of one control step: a grip pose in the world and a gripper sign."""

    position: np.ndarray
    rotation: np.ndarray
    gripper: float


class Task(ABC):
    """A manipulation task; one file in `jaxcam/sim/tasks` each.

    It names what it needs and never asks which engine runs it. Functions of states use only the
    array namespace of their input, so they run on host and on device.
    """

    name: ClassVar[str]
    prompt: ClassVar[str]
    """The task in words, for policies that read; the authors'."""
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
    def objects(self) -> list[Any]:
        """What is moved, in the terms of the task's simulator."""

    @abstractmethod
    def scene(self, name: str) -> World:
        """The task's world, `fixed` or `randomized`; made once a process.

        Raises:
            ConfigError: if there is no such scene.
        """

    @abstractmethod
    def unplaced(self, scene: Any, seed: int) -> Start:
        """The start of episode `seed` but for what `place` draws, and the arm's noise."""

    @abstractmethod
    def place(self, scene: Any, rng: np.random.Generator, start: Start) -> None:
        """Draws an episode into the arrays of `start`: object poses, varied sizes, markers."""

    @abstractmethod
    def success(self, scene: Any, state: State, start: Start) -> Array:
        """Whether the task is done in `state`, of episodes that began at `start`: bool [...]."""

    @abstractmethod
    def expert(self, scene: Any, sight: Sight) -> Iterator[Aim]:
        """Shows the task: yields an aim per control step, `sight` being renewed in between."""

    @abstractmethod
    def require(self) -> None:
        """Makes sure that this machine can run the task.

        Raises:
            SimError: if it cannot; the message says what is missing and how to get it.
        """

    def rng(self, seed: int) -> np.random.Generator:
        """Chance of episode `seed`'s expert."""
        return np.random.default_rng([seed, 2])

    def start(self, scene: World, seed: int) -> Start:
        """The start of episode `seed`: objects, arm and, in randomised scenes, table and room.

        The same seed gives the same start whatever the batch, the policy and its training seed.
        Fixed and randomised scenes share the draws of objects and arm.
        """
        rng = np.random.default_rng([seed, 0])
        start = self.unplaced(scene, seed)
        start.qpos[scene.arm] = scene.home + START_JOINT_NOISE * rng.standard_normal(7)
        self.place(scene, rng, start)
        return start


def shifted_fixtures(
    scene: World, markers: int, seed: int, table_shift: float, room_shift: float
) -> np.ndarray:
    """Poses (xyz, wxyz) [2 + markers, 7] of table, room and markers at the start of an episode.

    In randomised scenes table and room are moved by up to a half-range (m) and turned; markers are
    at the origin, for `Task.place` to put somewhere.
    """
    rng = np.random.default_rng([seed, 1])
    poses = np.zeros((2 + markers, 7))
    poses[:, 3] = 1
    if scene.name == "randomized":
        for pose, reach in zip(poses[:2], (table_shift, room_shift), strict=True):
            pose[:2] = rng.uniform(-reach, reach, 2)
            yaw = rng.uniform(-np.pi, np.pi)
            pose[3], pose[6] = np.cos(yaw / 2), np.sin(yaw / 2)
    return poses


def starts(task: Task, scene: World, seeds: range | list[int]) -> Start:
    """The starts of several episodes, stacked."""
    each = [task.start(scene, seed) for seed in seeds]
    return Start(*(np.stack(x) for x in zip(*each, strict=True)))
