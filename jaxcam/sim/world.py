"""What the rest of the package knows of a task's world, whichever simulator it lives in."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol

import numpy as np

from jaxcam.rays.rotations import Array, array_namespace

if TYPE_CHECKING:
    from jaxcam.sim.engine import ControllerName, Engine


class View(NamedTuple):
    """What to draw: B worlds, each seen by one camera."""

    qpos: Array
    """Joint positions [B, nq]."""
    geom_size: Array
    """Sizes (m) of the task's varied geoms [B, v, 3]."""
    fixtures: Array
    """Poses (xyz, wxyz) of table, room and markers [B, 2 + markers, 7]."""
    K: Array
    """Intrinsics in pixels of the picture [B, 3, 3]; no skew."""
    world_from_camera: Array
    """Camera poses [B, 4, 4], OpenCV axes."""


class Painter(Protocol):
    """Draws batches of views of one world, all of one size."""

    scene: Any
    height: int
    width: int

    def rgb(self, view: View) -> np.ndarray:
        """Pictures, uint8 [B, H, W, 3], top row first."""
        ...


PROPRIO_DIM = 11
"""Numbers that the robot feels, see `World.proprio`."""


@dataclass(frozen=True, kw_only=True)
class World(ABC):
    """A task's world: its robot in the arrays of states, and who steps and draws it."""

    engines: ClassVar[tuple[str, ...]]
    """Names of the engines that step it. The first makes demonstrations."""
    packages: ClassVar[tuple[str, ...]]
    """Distributions whose versions shape what happens in it."""

    table_top: ClassVar[float]
    """Height of the table's surface (m)."""

    name: str
    """`fixed` or `randomized`."""
    nq: int
    """Length of a state's positions."""
    nv: int
    """Length of a state's velocities."""
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

    @abstractmethod
    def qpos_of(self, body: str) -> int:
        """Address in qpos of the pose (xyz, wxyz) of an object's body."""

    @abstractmethod
    def engine(
        self, name: str, controller: "ControllerName", varied: Sequence[str] = ()
    ) -> "Engine":
        """The engine of that name, one of `engines`; see `jaxcam.sim.make_engine`."""

    @property
    @abstractmethod
    def fastest_engine(self) -> str:
        """Name of the engine that is the fastest on this machine."""

    @abstractmethod
    def painter(
        self, height: int, width: int | None = None, *, varied: Sequence[str] = ()
    ) -> Painter:
        """What draws the world.

        Args:
            height: of the pictures (pixels).
            width: of the pictures (pixels); `height` when None.
            varied: the task's varied geoms.
        """

    @property
    @abstractmethod
    def look(self) -> str:
        """What makes one painter's pictures differ from another's: kept with pictures and rows."""

    @property
    @abstractmethod
    def painter_uses_all_cores(self) -> bool:
        """Whether one painter draws as fast as several, each in a process of its own."""

    def proprio(self, qpos: Array, grip_position: Array) -> Array:
        """What the robot feels, float32 [..., PROPRIO_DIM].

        Joint angles (rad) [7], grip site in the base frame (m) [3], opening of the fingers (m).
        """
        local = (grip_position - self.world_from_base[:3, 3]) @ self.world_from_base[:3, :3]
        opening = abs(qpos[..., self.fingers]).sum(-1, keepdims=True)
        xp = array_namespace(qpos)
        return xp.concatenate([qpos[..., self.arm], local, opening], -1).astype(np.float32)
