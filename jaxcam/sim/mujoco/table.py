"""Tasks on robosuite's table, in MuJoCo."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from jaxcam.rays import POSE_RANGES, PoseRanges
from jaxcam.sim.mujoco.objects import Object
from jaxcam.sim.simulators import SimulatorName
from jaxcam.sim.task import Task

TABLE_TOP = 0.8
"""Height of the table's surface (m), robosuite's default."""


class TableTask(Task):
    """A task on robosuite's table."""

    simulator: ClassVar[SimulatorName] = "mujoco"
    cameras: ClassVar[PoseRanges] = POSE_RANGES["robosuite"]
    fovy_deg: ClassVar[float] = 45.0
    """MuJoCo's default, as the authors' agentview."""
    hulls: ClassVar[Mapping[str, np.ndarray]] = MappingProxyType({})
    """Corners (m) [n, 3] of the convex hulls that geoms collide with, where those are meshes."""

    @abstractmethod
    def objects(self) -> Sequence[Object]:
        """What stands on the table."""

    def require(self) -> None:
        """What it needs came with the package."""
