"""What the rest of the package knows of a task's world, whichever simulator it lives in."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar, get_args

import numpy as np

from jaxcam.config.names import SceneName, names_of
from jaxcam.errors import ConfigError, closest
from jaxcam.rays.rotations import Array, array_namespace
from jaxcam.sim.simulators import SimulatorName

JOINTS = tuple(f"joint_{i}" for i in range(1, 8))
"""Names of the arm's joints."""
STATE_NAMES = (*JOINTS, "grip_x", "grip_y", "grip_z", "opening")
"""Names of the numbers that the robot feels, see `World.proprio`."""
PROPRIO_DIM = len(STATE_NAMES)
"""How many they are."""


@dataclass(frozen=True, kw_only=True, eq=False)
class World(ABC):
    """A task's world: where its robot and objects are in the arrays of states."""

    simulator: ClassVar[SimulatorName]
    """Who steps and draws it, see `jaxcam.sim.simulators`."""
    table_top: ClassVar[float]
    """Height of the table's surface (m)."""
    table_middle: ClassVar[float]
    """Height (m) of the origin of the table that is seen, in `Start.fixtures`."""
    base_from_grip: ClassVar[np.ndarray]
    """Axes [3, 3] in the base of a grip that points down as at `home`, to within 0.2 rad."""

    name: SceneName
    nq: int
    """Length of a state's positions."""
    nv: int
    """Length of a state's velocities."""
    qpos0: np.ndarray = field(repr=False)
    """Positions [nq] before a task has placed anything."""
    arm: np.ndarray = field(repr=False)
    """Indices of the seven arm joints in qpos (and, the joints being hinges, in qvel)."""
    fingers: np.ndarray = field(repr=False)
    """Indices of the two finger joints in qpos (and in qvel)."""
    home: np.ndarray = field(repr=False)
    """Arm joint angles (rad) [7] from which episodes start, before noise."""
    world_from_base: np.ndarray = field(repr=False)
    """Pose of the robot's base [4, 4]; ray-maps and policies live in this frame."""
    joint_lag: float
    """Time (s) by which joints that move steadily trail behind the targets of
    `joint_position`."""

    @property
    def nominal_grip(self) -> np.ndarray:
        """Axes [3, 3] in the world of the grip that absolute rotations are counted from."""
        return self.world_from_base[:3, :3] @ self.base_from_grip

    @abstractmethod
    def qpos_of(self, body: str) -> int:
        """Address in qpos of the pose (xyz, wxyz) of an object's body."""

    @abstractmethod
    def size_of(self, geom: str) -> np.ndarray:
        """Usual size (m) [3] of a geom that tasks may vary."""

    def proprio(self, qpos: Array, grip_position: Array) -> Array:
        """What the robot feels, float32 [..., PROPRIO_DIM].

        Joint angles (rad) [7], grip site in the base frame (m) [3], opening of the fingers (m).
        """
        local = (grip_position - self.world_from_base[:3, 3]) @ self.world_from_base[:3, :3]
        opening = abs(qpos[..., self.fingers]).sum(-1, keepdims=True)
        xp = array_namespace(qpos)
        return xp.concatenate([qpos[..., self.arm], local, opening], -1).astype(np.float32)


def scene_name(name: str) -> SceneName:
    """The scene of that name.

    Raises:
        ConfigError: If there is none; the message names the closest.
    """
    for known in get_args(SceneName):
        if name == known:
            return known
    raise ConfigError(f"Unknown scene {name!r}{closest(name, names_of(SceneName))}.")
