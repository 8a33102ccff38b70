"""ManiSkill's actions of its Panda, in each control mode, as absolute grip targets.

Facts of mani_skill 3.0.1 (`agents/controllers`): which modes are normalised, what deltas are added
to, and that `pd_ee_delta_pose` scales a rotation by its lower bound, which turns it around.
"""

import numpy as np

from jaxcam.errors import DatasetError, closest
from jaxcam.rays.rotations import matrix_from_rotvec
from jaxcam.sim.maniskill import kinematics

DELTA = 0.1
"""What 1 means in modes of deltas: m of a position, rad of an angle."""
LEAD = 2
"""Control steps by which the pose that becomes a target lies ahead where actions are velocities:
the joints' drives trail 0.1 s behind."""
SIZES = {
    "pd_joint_pos": 8,
    "pd_joint_delta_pos": 8,
    "pd_joint_target_delta_pos": 8,
    "pd_ee_pose": 7,
    "pd_ee_delta_pose": 7,
    "pd_ee_target_delta_pose": 7,
    "pd_ee_delta_pos": 4,
    "pd_ee_target_delta_pos": 4,
}
"""Length of an action, the gripper's included, in the modes that say where to go."""

VELOCITIES = ("pd_joint_vel", "pd_joint_pos_vel", "pd_joint_delta_pos_vel")
"""Modes whose actions are velocities, or have some: the way of the arm says where they led."""

Poses = tuple[np.ndarray, np.ndarray]
"""Positions (m) [T, 3] and axes [T, 3, 3]."""


def check_mode(mode: str) -> None:
    """Refuses a control mode whose actions nobody here can read.

    Raises:
        DatasetError: It is none of the Panda's.
    """
    if mode not in SIZES and mode not in VELOCITIES:
        raise DatasetError(f"no control mode {mode!r}{closest(mode, [*SIZES, *VELOCITIES])}")


def grip_targets(mode: str, actions: np.ndarray, joints: np.ndarray) -> Poses:
    """Where each action sends the grip, in the base's frame.

    Args:
        mode: Control mode; where it does not say where to go, the ways of the arm do.
        actions: [T, A], the gripper last.
        joints: Joint angles (rad) [T + 1, 7] before each action, and after the last one.

    Raises:
        DatasetError: If actions are not as long as the mode's, or the mode is none.
    """
    check_mode(mode)
    if (size := SIZES.get(mode, actions.shape[1])) != actions.shape[1]:
        raise DatasetError(f"actions of {actions.shape[1]} numbers; {mode} has {size}.")
    if mode in VELOCITIES:
        ahead = np.minimum(np.arange(len(actions)) + LEAD, len(actions))
        return kinematics.forward(joints[ahead])[:2]
    if mode.startswith("pd_joint"):
        return kinematics.forward(_joint_targets(mode, actions[:, :7], joints))[:2]
    return _pose_targets(mode, actions[:, :-1], *kinematics.forward(joints)[:2])


def gripper_signs(actions: np.ndarray) -> np.ndarray:
    """Signs [T], positive closes: ManiSkill's positive opens."""
    signs, last = np.empty(len(actions)), -1.0
    for t, value in enumerate(actions[:, -1]):
        last = -float(np.sign(value)) or last
        signs[t] = last
    return signs


def _joint_targets(mode: str, actions: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Joint angles (rad) [T, 7]."""
    if mode == "pd_joint_pos":
        return actions
    moves = DELTA * np.clip(actions, -1, 1)
    if mode == "pd_joint_delta_pos":
        return joints[:-1] + moves
    return joints[0] + np.cumsum(moves, 0)


def _pose_targets(
    mode: str, actions: np.ndarray, position: np.ndarray, rotation: np.ndarray
) -> Poses:
    """Poses that end-effector modes ask for, measured poses [T + 1, ...] being given."""
    if mode == "pd_ee_pose":
        return actions[:, :3], _from_euler(actions[:, 3:])
    moves = DELTA * np.clip(actions[:, :3], -1, 1)
    turns = np.zeros((len(actions), 3))
    if mode.endswith("pose"):
        length = np.linalg.norm(actions[:, 3:], axis=-1, keepdims=True)
        turns = -DELTA * actions[:, 3:] / np.maximum(length, 1)
    at, axes = position[:-1].copy(), rotation[:-1].copy()
    for t, turn in enumerate(_from_euler(turns)):
        if "target" in mode and t:
            at[t], axes[t] = at[t - 1], axes[t - 1]
        at[t], axes[t] = at[t] + moves[t], turn @ axes[t]
    return at, axes


def _from_euler(angles: np.ndarray) -> np.ndarray:
    """Rotations [T, 3, 3] about x, then the new y, then the new z (rad) [T, 3]."""
    about = (matrix_from_rotvec(angles[:, i : i + 1] * np.eye(3)[i]) for i in range(3))
    x, y, z = about
    return x @ y @ z
