"""Tasks in ManiSkill, as the rest of the package sees them."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from jaxcam.rays.rotations import Array, array_namespace
from jaxcam.sim.maniskill.machine import require
from jaxcam.sim.simulators import SimulatorName
from jaxcam.sim.task import Task
from jaxcam.sim.types import Start

GOAL_RADIUS = 0.1
"""Of the round target on the table (m), where a task has one."""
_GOAL_HEIGHT, _LYING = 1e-3, (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)
"""Height (m) of the target, which is thin, and what turns ManiSkill's, a disc about x, to lie."""


def goal_pose(place: np.ndarray) -> np.ndarray:
    """Pose (xyz, wxyz) [7] of the round target whose middle is at x and y (m) [2]."""
    return np.array([*place, _GOAL_HEIGHT, *_LYING])


def is_over_goal(place: Array, start: Start) -> Array:
    """Whether places x, y (m) [..., 2] are over the round target."""
    aside = place - start.fixtures[..., 2, :2]
    return array_namespace(place).sqrt((aside**2).sum(-1)) < GOAL_RADIUS


class ManiSkillTask(Task):
    """A task in one of `jaxcam.sim.maniskill.envs`."""

    simulator: ClassVar[SimulatorName] = "sapien"
    env: ClassVar[str]
    """Name of its environment."""
    base: ClassVar[tuple[float, float, float]] = (-0.615, 0.0, 0.0)
    """The robot's base on the table (m), and its turn (rad) about the vertical."""

    @abstractmethod
    def objects(self) -> Sequence[str]:
        """ManiSkill's names of the actors that move."""

    def require(self) -> None:
        """ManiSkill, and a Vulkan device; see `Task.require`."""
        require()
