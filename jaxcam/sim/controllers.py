"""Arm and gripper controllers, written once for NumPy and JAX.

Every function takes arrays with any leading batch axes and works in the namespace of its input:
the native engine runs it under NumPy in float64, MJX under `jax.jit`. Control laws, gains and
update order follow robosuite 1.5.2 (`controllers/parts/arm/osc.py`, `controllers/parts/generic/
joint_pos.py`, `models/grippers/panda_gripper.py`), checked against trajectories recorded from it
(`tests/golden/make_robosuite_osc.py`).
"""

from typing import Any, NamedTuple

import numpy as np

from jaxcam.rotations import Array, array_namespace, matrix_from_rotvec
from jaxcam.sim.engine import ControllerName

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
    """What the controllers read of the simulator, at the current substep."""

    q: Array
    """Joint angles (rad) [..., 7]."""
    qd: Array
    """Joint velocities (rad/s) [..., 7]."""
    position: Array
    """Grip site in the world (m) [..., 3]."""
    rotation: Array
    """Grip site's axes in the world [..., 3, 3]."""
    jacobian: Array
    """Grip site's Jacobian, translation above rotation [..., 6, 7]."""
    mass: Array
    """Joint-space inertia [..., 7, 7], armature included."""
    bias: Array
    """Gravity and Coriolis torques (N m) [..., 7]."""


def osc_pose(arm: ArmState, position: Array, rotation: Array, rest: Array) -> Array:
    """Operational-space control of the grip site's pose.

    Args:
        arm: current state.
        position: target in the world (m) [..., 3].
        rotation: target axes in the world [..., 3, 3].
        rest: joint angles (rad) [..., 7] that the null space is pulled to (the episode's start).

    Returns:
        Joint torques (N m) [..., 7], gravity compensated, not yet clipped.
    """
    xp = array_namespace(arm.q)
    jacobian_t = xp.swapaxes(arm.jacobian, -1, -2)
    velocity = _apply(arm.jacobian, arm.qd)
    error = xp.concatenate(
        [position - arm.position, _rotation_error(xp, arm.rotation, rotation)], -1
    )
    acceleration = OSC_KP * error - 2 * np.sqrt(OSC_KP) * velocity

    # Operational-space inertia, translation and rotation decoupled for the task...
    inverse = arm.jacobian @ xp.linalg.solve(arm.mass, jacobian_t)
    wrench = xp.concatenate(
        [
            _solve(xp, inverse[..., :3, :3], acceleration[..., :3]),
            _solve(xp, inverse[..., 3:, 3:], acceleration[..., 3:]),
        ],
        -1,
    )
    # ...and coupled for the null space: N^T M a = M a - J^T (J M^-1 J^T)^-1 J a.
    rest_acceleration = NULL_KP * (rest - arm.q) - 2 * np.sqrt(NULL_KP) * arm.qd
    wrench = wrench - _solve(xp, inverse, _apply(arm.jacobian, rest_acceleration))
    return _apply(jacobian_t, wrench) + _apply(arm.mass, rest_acceleration) + arm.bias


def joint_position(arm: ArmState, target: Array) -> Array:
    """Joint torques (N m) [..., 7] that bring the arm to joint angles `target` (rad) [..., 7]."""
    acceleration = JOINT_KP * (target - arm.q) - 2 * np.sqrt(JOINT_KP) * arm.qd
    return _apply(arm.mass, acceleration) + arm.bias


def goal(controller: ControllerName, target: Array, rest: Array) -> tuple[Array, ...]:
    """What a controller is asked for in a control step, as its arguments behind the arm's state.

    Args:
        controller: its name.
        target: of the command (`jaxcam.sim.engine.Command`).
        rest: joint angles (rad) [..., 7] that OSC's null space is pulled to.
    """
    if controller == "joint_position":
        return (target,)
    return target[..., :3], matrix_from_rotvec(target[..., 3:]), rest


def torque(controller: ControllerName, arm: ArmState, *goal: Array) -> Array:
    """Joint torques (N m) [..., 7] of the controller of that name, not yet clipped."""
    return (joint_position if controller == "joint_position" else osc_pose)(arm, *goal)


def gripper_command(closed: Array, action: Array) -> Array:
    """Moves the gripper's command [-1 open, 1 closed] one control step by the action's sign."""
    xp = array_namespace(closed)
    return xp.clip(closed + GRIPPER_SPEED * xp.sign(action), -1.0, 1.0)


def finger_targets(closed: Array) -> Array:
    """Position targets (m) [..., 2] of the two finger servos for a gripper command [...]."""
    xp = array_namespace(closed)
    opening = FINGER_RANGE / 2 * (1 - closed)
    return xp.stack([opening, -opening], -1)


def _rotation_error(xp: Any, current: Array, target: Array) -> Array:
    """Half the sum of the axes' cross products: sin(angle) times the axis of the rotation left."""
    a, b, c = (current[..., i, :] for i in range(3))
    x, y, z = (target[..., i, :] for i in range(3))
    # Written out: NumPy's `cross` takes as long as all the solving above.
    return 0.5 * xp.stack([b * z - c * y, c * x - a * z, a * y - b * x], -2).sum(-1)


def _apply(matrix: Array, vector: Array) -> Array:
    return (matrix @ vector[..., None])[..., 0]


def _solve(xp: Any, matrix: Array, vector: Array) -> Array:
    return xp.linalg.solve(matrix, vector[..., None])[..., 0]
