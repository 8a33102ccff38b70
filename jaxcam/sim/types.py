"""What goes between tasks, engines and painters: records of arrays, in NumPy or JAX."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from jaxcam.rays.rotations import Array

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
    """Accelerations that the constraint solver starts from [B, nv]; [B, 0] in SAPIEN."""
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
    lens: Array | None = None
    """Coefficients from `jaxcam.rays.lens.pack` [B, 9], which `jaxcam.sim.lenses` draws; None where
    all are pinholes."""


@dataclass
class ExpertSight:
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
    error: bool = False
    """Whether it errs on purpose, so that what follows shows how to go on: policies see where it
    leads and are not taught to do it."""


Success = Callable[[State, Start], Array]
"""Whether the task is done in each world of a state [B], of episodes that began at a start. It
knows its world already, see `Task.success_in`."""
