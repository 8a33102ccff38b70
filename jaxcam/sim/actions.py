"""The paper's four action spaces, to and from absolute controller targets (section V-A4).

Inside, an action is an absolute target per control step: a grip pose in the world (position,
rotation vector) or joint angles, with the gripper's sign last. Delta spaces difference the targets
that were commanded one after the other, the first against what was measured at the start; at run
time deltas are accumulated from there. Rotations compose on SO(3): R_next = exp(delta) R, axes of
the base. `eef_delta_componentwise` subtracts and adds rotation vectors number by number, as the
authors' code does; near half a turn its deltas jump by up to a whole turn.

A gripper that points down is half a turn from the world's axes, just where rotation vectors jump.
So `eef_abs` counts them from a nominal grip, which is the world's (`World.nominal_grip`): R =
exp(r) R_nominal, r without jumps along a demonstration. `eef_abs_world` is what version 0.1.0
called `eef_abs`: rotation vectors from the world's axes, jumps included. Its runs keep it.
"""

import itertools

import numpy as np

from jaxcam.config.names import Rotations
from jaxcam.rays.rotations import (
    Array,
    array_namespace,
    matrix_from_rotvec,
    nearest_rotation,
    rotvec_from_matrix,
)
from jaxcam.sim.types import ControllerName, State
from jaxcam.sim.world import JOINTS

BEYOND = 1e6
"""No action is as large, in metres, radians or otherwise: simulators fail on such numbers, and
that is the policy's failure."""
ACTION_SPACES = ("eef_delta", "eef_abs", "joint_delta", "joint_abs")
"""The paper's four; the authors' component-wise differencing is a fifth, to reproduce them."""
POSE = ("x", "y", "z", "rx", "ry", "rz")
"""Names of a grip's position and rotation vector."""


def space_of(name: str, rotations: Rotations) -> str:
    """The space that a run's settings mean.

    Args:
        name: Its `action_space`.
        rotations: Its `rotations`.
    """
    return "eef_abs_world" if (name, rotations) == ("eef_abs", "world") else name


def is_absolute(space: str) -> bool:
    """Whether actions are targets themselves, rather than what they move by."""
    return space in ("eef_abs", "eef_abs_world", "joint_abs")


def is_joint(space: str) -> bool:
    """Whether actions are joint angles rather than grip poses."""
    return space.startswith("joint")


def is_delta(space: str) -> bool:
    """Whether actions say how far to go from the last target rather than where to."""
    return "_delta" in space


def controller_of(space: str) -> ControllerName:
    """The controller that executes a space's targets."""
    return "joint_position" if is_joint(space) else "osc_pose"


def action_dim(space: str) -> int:
    """Size of an action, gripper included."""
    return len(action_names(space))


def action_names(space: str) -> tuple[str, ...]:
    """Names of the numbers of an action, the gripper's last."""
    return (*(JOINTS if is_joint(space) else POSE), "gripper")


def are_numbers(actions: Array) -> Array:
    """Which chunks [B, T, A] can be executed: bool [B]; not with NaN, or what is too large."""
    return (abs(actions) < BEYOND).all((1, 2))


def measured(space: str, state: State, arm: np.ndarray) -> Array:
    """What deltas start from: the measured grip pose [B, 6] or joint angles [B, 7]."""
    if is_joint(space):
        return state.qpos[:, arm]
    xp = array_namespace(state.qpos)
    return xp.concatenate([state.grip_position, rotvec_from_matrix(state.grip_rotation)], -1)


def encode(
    space: str, targets: np.ndarray, gripper: np.ndarray, start: np.ndarray, nominal: np.ndarray
) -> np.ndarray:
    """Turns a demonstration's absolute targets into actions.

    Args:
        space: Of the actions.
        targets: Grip poses (m, rad; world) [T, 6] or joint angles (rad) [T, 7].
        gripper: Signs [T].
        start: What was measured before the first target [6] or [7].
        nominal: Axes in the world of the grip that `eef_abs` counts rotations from [3, 3].

    Returns:
        Actions [T, 7] or [T, 8].
    """
    if space == "eef_abs":
        turned = rotvec_from_matrix(matrix_from_rotvec(targets[:, 3:]) @ nominal.T)
        moves = np.concatenate([targets[:, :3], unwrapped(turned)], -1)
    elif is_absolute(space):
        moves = targets
    else:
        before = np.concatenate([start[None], targets[:-1]])
        moves = targets - before
        if space == "eef_delta":
            rotations = matrix_from_rotvec(targets[:, 3:])
            earlier = matrix_from_rotvec(before[:, 3:])
            moves[:, 3:] = rotvec_from_matrix(rotations @ earlier.swapaxes(-1, -2))
    return np.concatenate([moves, gripper[:, None]], -1)


def unwrapped(rotvecs: np.ndarray) -> np.ndarray:
    """The same rotations by vectors (rad) [T, 3] that do not jump from one to the next.

    The first stays as it is; a later one is longer than half a turn where the way leads there.
    """
    if (np.linalg.norm(np.diff(rotvecs, axis=0), axis=-1) <= np.pi).all():
        return rotvecs
    smooth = rotvecs.copy()
    for before, now in itertools.pairwise(smooth):
        angle = np.linalg.norm(now)
        along = now / angle if angle > 1e-9 else before / max(np.linalg.norm(before), 1e-9)
        now += 2 * np.pi * np.round((before @ along - angle) / (2 * np.pi)) * along
    return smooth


def decode(space: str, actions: Array, anchor: Array, nominal: Array) -> tuple[Array, Array]:
    """Turns a batch of action chunks into absolute targets, in the namespace of `anchor`.

    Args:
        space: Of the actions.
        actions: Chunks [B, T, 7] or [B, T, 8].
        anchor: The last target commanded, at the start what was measured [B, 6] or [B, 7].
        nominal: Axes in the world of the grip that `eef_abs` counts rotations from [3, 3].

    Returns:
        Targets [B, T, 6] or [B, T, 7], and gripper signs [B, T]. The last target is the next
        anchor.
    """
    xp = array_namespace(anchor)
    actions = xp.asarray(actions, anchor.dtype)
    moves, gripper = actions[..., :-1], actions[..., -1]
    if space == "eef_abs":
        rotations = matrix_from_rotvec(moves[..., 3:]) @ xp.asarray(nominal, anchor.dtype)
        return xp.concatenate([moves[..., :3], rotvec_from_matrix(rotations)], -1), gripper
    if is_absolute(space):
        return moves, gripper
    targets = anchor[:, None] + xp.cumsum(moves, 1)
    if space == "eef_delta":
        rotation = matrix_from_rotvec(anchor[:, 3:])
        steps = matrix_from_rotvec(moves[..., 3:])
        rotations = []
        for t in range(moves.shape[1]):
            rotation = steps[:, t] @ rotation
            rotations.append(rotvec_from_matrix(rotation))
        targets = xp.concatenate([targets[..., :3], xp.stack(rotations, 1)], -1)
    return targets, gripper


def averageable(space: str, targets: Array, gripper: Array) -> Array:
    """Absolute targets [..., 6 or 7] and gripper signs [...] as numbers whose mean has a meaning.

    Rotations become matrices [..., 13 in all]; means of rotation vectors fail near half a turn.
    """
    xp = array_namespace(targets)
    parts = [targets, gripper[..., None]]
    if not is_joint(space):
        rotation = matrix_from_rotvec(targets[..., 3:]).reshape(*targets.shape[:-1], 9)
        parts = [targets[..., :3], rotation, gripper[..., None]]
    return xp.concatenate(parts, -1)


def averaged(space: str, mean: Array) -> tuple[Array, Array]:
    """Targets and gripper signs of a mean of what `averageable` gives."""
    xp = array_namespace(mean)
    targets, gripper = mean[..., :-1], mean[..., -1]
    if not is_joint(space):
        rotation = nearest_rotation(targets[..., 3:].reshape(*mean.shape[:-1], 3, 3))
        targets = xp.concatenate([targets[..., :3], rotvec_from_matrix(rotation)], -1)
    return targets, gripper
