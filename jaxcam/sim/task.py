"""What a task is: its objects, how episodes start, when they succeed, and who shows how."""

import functools
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from jaxcam.rays import POSE_RANGES, PoseRanges
from jaxcam.rotations import Array
from jaxcam.sim.engine import Start, State
from jaxcam.sim.scene import TABLE_TOP, Scene, build_scene

START_JOINT_NOISE = 0.02
"""Standard deviation (rad) of the arm's joint angles at the start: robosuite's default."""
TABLE_SHIFT = 0.2
"""Half-range (m) of the table's shift against the robot in randomised scenes (authors' code)."""
ROOM_SHIFT = 2.0
"""Half-range (m) of the floor's shift against the robot in randomised scenes (authors' code)."""


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
    """A manipulation task on robosuite's table; one file in `jaxcam/sim/tasks` each.

    It names what it needs and never asks which engine runs it. Functions of states use only the
    array namespace of their input, so they run on host and on device.
    """

    name: ClassVar[str]
    horizon: ClassVar[int]
    """Control steps after which an episode has failed."""
    views: ClassVar[int]
    """Cameras that a policy sees at once (paper, section IV-A)."""
    stair: ClassVar[tuple[int, int]]
    """(n, m) of the stair-shaped camera schedule (paper, section IV-A)."""
    cameras: ClassVar[PoseRanges] = POSE_RANGES["robosuite"]
    """Where cameras are drawn from."""
    fovy_deg: ClassVar[float] = 45.0
    """Vertical field of view of the task's cameras: MuJoCo's default, as the authors' agentview."""
    markers: ClassVar[tuple[str, ...]] = ()
    """Objects that are seen and never touched; their poses follow table and room in `fixtures`."""
    hulls: ClassVar[Mapping[str, np.ndarray]] = MappingProxyType({})
    """Corners (m) [n, 3] of the convex hulls that geoms collide with, where those are meshes."""
    varied: ClassVar[tuple[str, ...]] = ()
    """Geoms of the physics model whose size differs between episodes; `<geom>_vis` shows them."""

    @abstractmethod
    def objects(self) -> list[Any]:
        """Robosuite objects on the table."""

    @abstractmethod
    def place(self, scene: Scene, rng: np.random.Generator, start: Start) -> None:
        """Draws an episode into the arrays of `start`: object poses, varied sizes, markers."""

    @abstractmethod
    def success(self, scene: Scene, state: State, start: Start) -> Array:
        """Whether the task is done in `state`, of episodes that began at `start`: bool [...]."""

    @abstractmethod
    def expert(self, scene: Scene, sight: Sight) -> Iterator[Aim]:
        """Shows the task: yields an aim per control step, `sight` being renewed in between."""

    def scene(self, name: str) -> Scene:
        """The task's world, `fixed` or `randomized`; made once a process.

        Raises:
            ConfigError: if there is no such scene.
        """
        return _scene(type(self), name)

    def rng(self, seed: int) -> np.random.Generator:
        """Chance of episode `seed`'s expert."""
        return np.random.default_rng([seed, 2])

    def start(self, scene: Scene, seed: int) -> Start:
        """The start of episode `seed`: objects, arm and, in randomised scenes, table and room.

        The same seed gives the same start whatever the batch, the policy and its training seed.
        Fixed and randomised scenes share the draws of objects and arm.
        """
        rng = np.random.default_rng([seed, 0])
        start = Start(
            qpos=scene.physics.qpos0.copy(),
            geom_size=np.reshape([scene.physics.geom(name).size for name in self.varied], (-1, 3)),
            fixtures=_fixtures(scene, len(self.markers), np.random.default_rng([seed, 1])),
        )
        start.qpos[scene.arm] = scene.home + START_JOINT_NOISE * rng.standard_normal(7)
        self.place(scene, rng, start)
        return start


@functools.cache
def _scene(task: type[Task], name: str) -> Scene:
    return build_scene(task().objects(), name, task.markers, task.hulls)


def _fixtures(scene: Scene, markers: int, rng: np.random.Generator) -> np.ndarray:
    """Poses (xyz, wxyz) [2 + markers, 7] of table and room (the authors' ranges), and markers."""
    poses = np.zeros((2 + markers, 7))
    poses[:, 3] = 1
    poses[0, 2] = TABLE_TOP - scene.table_thickness / 2
    if scene.name == "randomized":
        for pose, reach in zip(poses[:2], (TABLE_SHIFT, ROOM_SHIFT), strict=True):
            pose[:2] = rng.uniform(-reach, reach, 2)
            yaw = rng.uniform(-np.pi, np.pi)
            pose[3], pose[6] = np.cos(yaw / 2), np.sin(yaw / 2)
    return poses


def starts(task: Task, scene: Scene, seeds: range | list[int]) -> Start:
    """The starts of several episodes, stacked."""
    each = [task.start(scene, seed) for seed in seeds]
    return Start(*(np.stack(x) for x in zip(*each, strict=True)))
