"""Tasks on robosuite's table, in MuJoCo."""

import functools
from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from jaxcam.rays import POSE_RANGES, PoseRanges
from jaxcam.sim.engine import Start
from jaxcam.sim.mujoco.scene import TABLE_TOP, Scene, build_scene
from jaxcam.sim.task import Task, shifted_fixtures

TABLE_SHIFT = 0.2
"""Half-range (m) of the table's shift against the robot in randomised scenes (authors' code)."""
ROOM_SHIFT = 2.0
"""Half-range (m) of the floor's shift against the robot in randomised scenes (authors' code)."""


class TableTask(Task):
    """A task on robosuite's table; its `objects` are robosuite's."""

    cameras: ClassVar[PoseRanges] = POSE_RANGES["robosuite"]
    fovy_deg: ClassVar[float] = 45.0
    """MuJoCo's default, as the authors' agentview."""
    hulls: ClassVar[Mapping[str, np.ndarray]] = MappingProxyType({})
    """Corners (m) [n, 3] of the convex hulls that geoms collide with, where those are meshes."""

    def scene(self, name: str) -> Scene:
        """Arena, robot and objects from robosuite's models; see `Task.scene`."""
        return _scene(type(self), name)

    def require(self) -> None:
        """What it needs came with the package."""

    def unplaced(self, scene: Scene, seed: int) -> Start:
        """Objects where the model has them; `varied` geoms are drawn as `<geom>_vis`."""
        fixtures = shifted_fixtures(scene, len(self.markers), seed, TABLE_SHIFT, ROOM_SHIFT)
        fixtures[0, 2] = TABLE_TOP - scene.table_thickness / 2
        return Start(
            qpos=scene.physics.qpos0.copy(),
            geom_size=np.reshape([scene.physics.geom(name).size for name in self.varied], (-1, 3)),
            fixtures=fixtures,
        )


@functools.cache
def _scene(task: type[TableTask], name: str) -> Scene:
    return build_scene(task().objects(), name, task.markers, task.hulls)
