"""Tasks in ManiSkill, as the rest of the package sees them.

Nothing here imports PyTorch or SAPIEN: those live in child processes (`jaxcam.sim.maniskill.pool`).
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, get_args

import numpy as np

from jaxcam.config.names import SceneName
from jaxcam.errors import ConfigError, closest
from jaxcam.rays.rotations import Array, array_namespace, matrix_from_rotvec
from jaxcam.sim.controllers import CONTROL_HZ
from jaxcam.sim.engine import ControllerName, Engine, Start
from jaxcam.sim.maniskill.memory import JOINTS
from jaxcam.sim.task import Task, shifted_fixtures
from jaxcam.sim.world import Painter, World

HOME = np.array([0, 1 / 8, 0, -5 / 8, 0, 3 / 4, 1 / 4]) * np.pi
"""Arm joint angles (rad) from which episodes start: the rest pose of ManiSkill's Panda."""
OPEN = 0.04
"""Opening of one finger (m) when open."""
GOAL_RADIUS = 0.1
"""Of the round target on the table (m), where a task has one."""
_GOAL_HEIGHT, _LYING = 1e-3, (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)
"""Height (m) of the target, which is thin, and what turns ManiSkill's, a disc about x, to lie."""
TABLE_SHIFT = 0.2
"""Half-range (m) of the shift of the table that is seen in randomised scenes (authors' code)."""
ROOM_SHIFT = 2.0
"""Half-range (m) of the floor's shift in randomised scenes."""
JOINT_LAG = 0.1 - 0.5 / CONTROL_HZ
"""Time (s) by which steadily moving joints are behind their target at the end of a control step:
damping over stiffness of ManiSkill's Panda, less half of the step, in which targets stand still."""


def goal_pose(place: np.ndarray) -> np.ndarray:
    """Pose (xyz, wxyz) [7] of the round target whose middle is at x and y (m) [2]."""
    return np.array([*place, _GOAL_HEIGHT, *_LYING])


def is_over_goal(place: Array, start: Start) -> Array:
    """Whether places x, y (m) [..., 2] are over the round target."""
    aside = place - start.fixtures[..., 2, :2]
    return array_namespace(place).sqrt((aside**2).sum(-1)) < GOAL_RADIUS


@dataclass(frozen=True, kw_only=True)
class SapienWorld(World):
    """A task's world in SAPIEN.

    A state's `qpos` are the joint angles, then each object's pose (xyz, wxyz) in the world; its
    `qvel` the joint velocities, then each object's linear and angular velocity in the world.
    """

    engines: ClassVar[tuple[str, ...]] = ("sapien", "sapien-gpu")
    packages: ClassVar[tuple[str, ...]] = ("mani-skill", "sapien", "torch")
    table_top: ClassVar[float] = 0.0

    task: str
    """Name of the task."""
    env: str
    """Name of its environment in `jaxcam.sim.maniskill.envs`."""
    objects: tuple[str, ...]
    """Names of the actors that move."""
    markers: tuple[str, ...]
    """Names of the actors that are seen and never touched."""
    joint_lag: float = JOINT_LAG

    def qpos_of(self, body: str) -> int:
        """Address in qpos of an object's pose."""
        return JOINTS + 7 * self.objects.index(body)

    def engine(self, name: str, controller: ControllerName, varied: Sequence[str] = ()) -> Engine:
        """PhysX in child processes, on the CPU or on a card; see `World.engine`."""
        from jaxcam.sim.maniskill.engine import SapienEngine
        from jaxcam.sim.maniskill.pool import pool_of

        return SapienEngine(self, controller, pool_of(self, on_gpu=name == "sapien-gpu"))

    @property
    def fastest_engine(self) -> str:
        """PhysX on the card, if there is one for it."""
        from jaxcam.sim.maniskill.machine import cuda

        return "sapien-gpu" if cuda().kind else "sapien"

    def painter(
        self, height: int, width: int | None = None, *, varied: Sequence[str] = ()
    ) -> Painter:
        """SAPIEN's rasteriser, in child processes; see `World.painter`."""
        from jaxcam.sim.maniskill.machine import cuda
        from jaxcam.sim.maniskill.pool import pool_of
        from jaxcam.sim.maniskill.render import SapienPainter

        return SapienPainter(self, height, width, pool=pool_of(self, on_gpu=bool(cuda().kind)))

    @property
    def look(self) -> str:
        """SAPIEN's version and ManiSkill's shader."""
        from jaxcam.sim.maniskill.render import look

        return look()

    @property
    def painter_uses_all_cores(self) -> bool:
        """Each of its child processes draws on a core, or one on the card."""
        return True


class ManiSkillTask(Task):
    """A task in one of `jaxcam.sim.maniskill.envs`; its `objects` are names of actors."""

    env: ClassVar[str]
    """Name of its environment."""
    base: ClassVar[tuple[float, float, float]] = (-0.615, 0.0, 0.0)
    """The robot's base on the table (m), and its turn (rad) about the vertical."""

    def scene(self, name: str) -> SapienWorld:
        """The world of the task's environment; see `Task.scene`."""
        return _world(type(self), name)

    def require(self) -> None:
        """ManiSkill, and a Vulkan device; see `Task.require`."""
        from jaxcam.sim.maniskill.machine import require

        require()

    def unplaced(self, scene: SapienWorld, seed: int) -> Start:
        """Objects at the origin, fingers open."""
        qpos = np.zeros(scene.nq)
        qpos[scene.fingers] = OPEN
        for name in scene.objects:
            qpos[scene.qpos_of(name) + 3] = 1
        return Start(
            qpos=qpos,
            geom_size=np.zeros((0, 3)),
            fixtures=shifted_fixtures(scene, len(self.markers), seed, TABLE_SHIFT, ROOM_SHIFT),
        )


@functools.cache
def _world(task: type[ManiSkillTask], name: str) -> SapienWorld:
    if name not in get_args(SceneName):
        raise ConfigError(f"Unknown scene {name!r}{closest(name, get_args(SceneName))}.")
    objects = tuple(task().objects())
    x, y, yaw = task.base
    world_from_base = np.eye(4)
    world_from_base[:3, :3] = matrix_from_rotvec(np.array([0, 0, yaw]))
    world_from_base[:2, 3] = x, y
    return SapienWorld(
        name=name,
        nq=JOINTS + 7 * len(objects),
        nv=JOINTS + 6 * len(objects),
        arm=np.arange(7),
        fingers=np.arange(7, JOINTS),
        home=HOME,
        world_from_base=world_from_base,
        task=task.name,
        env=task.env,
        objects=objects,
        markers=task.markers,
    )
