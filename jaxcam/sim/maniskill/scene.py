"""Worlds in SAPIEN, as the rest of the package sees them.

Nothing here imports PyTorch or SAPIEN: those live in child processes (`jaxcam.sim.maniskill.pool`).
"""

import functools
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from jaxcam.rays.rotations import matrix_from_rotvec
from jaxcam.sim.controllers import CONTROL_HZ
from jaxcam.sim.maniskill.memory import JOINTS
from jaxcam.sim.maniskill.task import ManiSkillTask
from jaxcam.sim.simulators import SimulatorName
from jaxcam.sim.world import World, scene_name

HOME = np.array([0, 1 / 8, 0, -5 / 8, 0, 3 / 4, 1 / 4]) * np.pi
"""Arm joint angles (rad) from which episodes start: the rest pose of ManiSkill's Panda."""
OPEN = 0.04
"""Opening of one finger (m) when open."""
JOINT_LAG = 0.1 - 0.5 / CONTROL_HZ
"""Time (s) by which steadily moving joints are behind their target at the end of a control step:
damping over stiffness of ManiSkill's Panda, less half of the step, in which targets stand still."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SapienWorld(World):
    """A task's world in SAPIEN.

    A state's `qpos` are the joint angles, then each object's pose (xyz, wxyz) in the world; its
    `qvel` the joint velocities, then each object's linear and angular velocity in the world.
    """

    simulator: ClassVar[SimulatorName] = "sapien"
    table_top: ClassVar[float] = 0.0
    table_middle: ClassVar[float] = 0.0
    base_from_grip: ClassVar[np.ndarray] = np.diag([1.0, -1, -1])

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

    def size_of(self, geom: str) -> np.ndarray:
        """No size differs between ManiSkill's episodes.

        Raises:
            KeyError: Always.
        """
        raise KeyError(geom)


def scene_of(task: ManiSkillTask, name: str) -> SapienWorld:
    """The world of a task's environment; made once a process.

    Raises:
        ConfigError: If there is no such scene.
    """
    return _scene_of(type(task), name)


@functools.cache
def _scene_of(task: type[ManiSkillTask], name: str) -> SapienWorld:
    objects = tuple(task().objects())
    x, y, yaw = task.base
    world_from_base = np.eye(4)
    world_from_base[:3, :3] = matrix_from_rotvec(np.array([0, 0, yaw]))
    world_from_base[:2, 3] = x, y
    qpos0 = np.zeros(JOINTS + 7 * len(objects))
    qpos0[7:JOINTS] = OPEN
    qpos0[JOINTS + 3 :: 7] = 1
    return SapienWorld(
        name=scene_name(name),
        nq=len(qpos0),
        nv=JOINTS + 6 * len(objects),
        qpos0=qpos0,
        arm=np.arange(7),
        fingers=np.arange(7, JOINTS),
        home=HOME,
        world_from_base=world_from_base,
        task=task.name,
        env=task.env,
        objects=objects,
        markers=task.markers,
    )
