"""Arm and gripper controllers, written once for every engine.

The control laws are those of one arm: the native engine compiles them with Numba in float64, MJX
maps them over worlds under `jax.jit`, and they run under NumPy as they stand. Control laws, gains
and update order follow robosuite 1.5.2 (`controllers/parts/arm/osc.py`, `controllers/parts/generic/
joint_pos.py`, `models/grippers/panda_gripper.py`), checked against trajectories recorded from it
(`tests/golden/make_robosuite_osc.py`).
"""

from typing import NamedTuple

import numpy as np

from jaxcam.rays.rotations import Array, array_namespace, matrix_from_rotvec
from jaxcam.sim.types import ControllerName

CONTROL_HZ = 20
"""Control steps per second (paper, and robosuite's default)."""
OSC_KP = 150.0
JOINT_KP = 50.0
JOINT_LAG = 2 / np.sqrt(JOINT_KP)
"""Time (s) by which joints that move steadily trail behind the targets of `joint_position`."""
NULL_KP = 10.0
GRIPPER_SPEED = 0.2
"""Change of the gripper's command per control step; its range is [-1 open, 1 closed]."""
FINGER_RANGE = 0.04
"""Opening of one finger (m) when open."""


class ArmState(NamedTuple):
    """What the controllers read of one world, at the current substep."""

    q: Array
    """Joint angles (rad) [7]."""
    qd: Array
    """Joint velocities (rad/s) [7]."""
    position: Array
    """Grip site in the world (m) [3]."""
    rotation: Array
    """Grip site's axes in the world [3, 3]."""
    jacobian: Array
    """Grip site's Jacobian, translation above rotation [6, 7]."""
    mass: Array
    """Joint-space inertia [7, 7], armature included."""
    bias: Array
    """Gravity and Coriolis torques (N m) [7]."""


class Sensed(NamedTuple):
    """What MuJoCo computes of a batch of worlds, a row each, at the current substep."""

    q: Array
    qd: Array
    position: Array
    rotation: Array
    motion: Array
    """The joints' motions [B, 7, 6], rotation before translation, about `origin`."""
    origin: Array
    """[B, 3] in the world (m)."""
    mass: Array
    """Joint-space inertia, sparse [B, nM]."""
    bias: Array


def solve(matrix: Array, vector: Array) -> Array:
    """`x` of `matrix @ x = vector`, `matrix` positive definite; in the namespace of its input."""
    return array_namespace(matrix).linalg.solve(matrix, vector)


def join(first: Array, second: Array) -> Array:
    """One vector behind the other, in the namespace of its input."""
    return array_namespace(first).concatenate((first, second))


def osc_pose(arm: ArmState, position: Array, rotation: Array, rest: Array) -> Array:
    """Operational-space control of the grip site's pose.

    Args:
        arm: Current state.
        position: Target in the world (m) [3].
        rotation: Target axes in the world [3, 3].
        rest: Joint angles (rad) [7] that the null space is pulled to (the episode's start).

    Returns:
        Joint torques (N m) [7], gravity compensated, not yet clipped.
    """
    jacobian, jacobian_t = arm.jacobian, arm.jacobian.T
    error = join(position - arm.position, rotation_error(arm.rotation, rotation))
    acceleration = OSC_KP * error - 2 * OSC_KP**0.5 * (jacobian @ arm.qd)

    # Operational-space inertia, translation and rotation decoupled for the task...
    inverse = jacobian @ solve(arm.mass, jacobian_t)
    force = solve(inverse[:3, :3], acceleration[:3])
    moment = solve(inverse[3:, 3:], acceleration[3:])
    # ...and coupled for the null space: N^T M a = M a - J^T (J M^-1 J^T)^-1 J a.
    rest_acceleration = NULL_KP * (rest - arm.q) - 2 * NULL_KP**0.5 * arm.qd
    wrench = join(force, moment) - solve(inverse, jacobian @ rest_acceleration)
    return jacobian_t @ wrench + arm.mass @ rest_acceleration + arm.bias


def joint_position(arm: ArmState, target: Array) -> Array:
    """Joint torques (N m) [7] that bring the arm to joint angles `target` (rad) [7]."""
    acceleration = JOINT_KP * (target - arm.q) - 2 * JOINT_KP**0.5 * arm.qd
    return arm.mass @ acceleration + arm.bias


def rotation_error(current: Array, target: Array) -> Array:
    """Half the sum of the axes' cross products [3]: sin(angle) times the axis of what is left."""
    turn = target @ current.T
    twice = turn - turn.T
    return 0.5 * join(twice[2:, 1], join(twice[:1, 2], twice[1:2, 0]))


def goal(controller: ControllerName, target: Array, rest: Array) -> tuple[Array, ...]:
    """What a controller is asked for in a control step, as its arguments behind the arm's state.

    Args:
        controller: Its name.
        target: Of the command (`jaxcam.sim.types.Command`).
        rest: Joint angles (rad) [..., 7] that OSC's null space is pulled to.
    """
    if controller == "joint_position":
        return (target,)
    return target[..., :3], matrix_from_rotvec(target[..., 3:]), rest


def torque(controller: ControllerName, arm: ArmState, *goal: Array) -> Array:
    """Joint torques (N m) [7] of the controller of that name, not yet clipped."""
    return (joint_position if controller == "joint_position" else osc_pose)(arm, *goal)


def pose_torques(
    sensed: Sensed,
    mass_at: Array,
    rows: Array,
    goal: tuple[Array, ...],
    limits: Array,
    out: Array,
) -> None:
    """Torques of `osc_pose`, clipped, for some of the worlds; the native engine compiles it.

    Args:
        sensed: Of all worlds.
        mass_at: Where each element of the inertia is in the sparse one [7, 7].
        rows: The worlds [n].
        goal: Of `osc_pose` for each of `rows`, see `goal`.
        limits: Least and greatest torques (N m) [2, 7].
        out: What is written, a row for each of all worlds [B, 7].
    """
    position, rotation, rest = goal
    for k in range(len(rows)):
        arm = sense(sensed, mass_at, rows[k])
        torque = osc_pose(arm, position[k], rotation[k], rest[k])
        out[rows[k]] = np.minimum(np.maximum(torque, limits[0]), limits[1])


def joint_torques(
    sensed: Sensed,
    mass_at: Array,
    rows: Array,
    goal: tuple[Array, ...],
    limits: Array,
    out: Array,
) -> None:
    """Torques of `joint_position`; as `pose_torques`."""
    for k in range(len(rows)):
        torque = joint_position(sense(sensed, mass_at, rows[k]), goal[0][k])
        out[rows[k]] = np.minimum(np.maximum(torque, limits[0]), limits[1])


def sense(sensed: Sensed, mass_at: Array, i: int) -> ArmState:
    """What the controllers need of world `i`."""
    lever = sensed.position[i] - sensed.origin[i]
    jacobian, mass = np.empty((6, 7)), np.empty((7, 7))
    for j in range(7):
        motion = sensed.motion[i, j]
        axis, slide = motion[:3], motion[3:]
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            jacobian[a, j] = slide[a] + axis[b] * lever[c] - axis[c] * lever[b]
            jacobian[3 + a, j] = axis[a]
        for k in range(7):
            mass[j, k] = sensed.mass[i, mass_at[j, k]]
    # Copies: Numba's matrix products want rows without gaps.
    return ArmState(
        sensed.q[i].copy(),
        sensed.qd[i].copy(),
        sensed.position[i],
        sensed.rotation[i].copy(),
        jacobian,
        mass,
        sensed.bias[i],
    )


def gripper_command(closed: Array, action: Array) -> Array:
    """Moves the gripper's command [-1 open, 1 closed] one control step by the action's sign."""
    xp = array_namespace(closed)
    return xp.clip(closed + GRIPPER_SPEED * xp.sign(action), -1.0, 1.0)


def finger_targets(closed: Array) -> Array:
    """Position targets (m) [..., 2] of the two finger servos for a gripper command [...]."""
    xp = array_namespace(closed)
    opening = FINGER_RANGE / 2 * (1 - closed)
    return xp.stack([opening, -opening], -1)
