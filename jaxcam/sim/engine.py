"""What a physics engine promises: batches of states in, batches of states out.

An engine knows the scene and a controller but no task. It advances worlds by control steps; a world
whose physics diverges is flagged and left, the others go on.
"""

from typing import Literal, NamedTuple, Protocol

from jaxcam.sim.controllers import Array

ControllerName = Literal["osc_pose", "joint_position"]


class Start(NamedTuple):
    """What fixes an episode before its first step; leading batch axes allowed."""

    qpos: Array
    """Joint positions [..., nq]."""
    geom_size: Array
    """Sizes (m) of the task's varied geoms [..., v, 3]."""
    fixtures: Array
    """Poses (xyz, wxyz) in the world of table, room and the task's markers [..., 2 + markers, 7];
    seen, never touched."""


class State(NamedTuple):
    """A batch of worlds between two control steps; enough to go on from."""

    qpos: Array
    """Joint positions [B, nq]."""
    qvel: Array
    """Joint velocities [B, nv]."""
    warmstart: Array
    """Accelerations that the constraint solver starts from [B, nv]."""
    closed: Array
    """Gripper command in [-1 open, 1 closed] [B]."""
    rest: Array
    """Arm joint angles (rad) at the episode's start [B, 7]: OSC's null-space target."""
    grip_position: Array
    """Grip site in the world (m) [B, 3]."""
    grip_rotation: Array
    """Grip site's axes in the world [B, 3, 3]."""
    ok: Array
    """False where the physics has diverged (non-finite or warned of) [B]."""


class Command(NamedTuple):
    """One control step's absolute targets."""

    target: Array
    """`osc_pose`: position (m) and rotation vector (rad) in the world [B, 6];
    `joint_position`: joint angles (rad) [B, 7]."""
    gripper: Array
    """Positive closes, negative opens [B]."""


class Engine(Protocol):
    """Steps a batch of worlds of one scene with one controller."""

    substeps: int
    """Physics steps per control step."""

    def reset(self, start: Start) -> State:
        """Puts a batch of worlds at their starts, at rest, gripper half open."""
        ...

    def step(self, state: State, command: Command, active: Array | None = None) -> State:
        """Advances the worlds one control step; those not `active` [B] stay as they are."""
        ...
