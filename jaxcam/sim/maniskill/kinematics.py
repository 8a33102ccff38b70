"""The Panda's arm in NumPy: where its grip is, and the joint angles that bring it to a pose.

ManiSkill's end-effector controllers turn a target pose into joint angles by iterating from where
the arm is, and hand these to the joints' drives; so does `inverse`, for a batch of arms at once.
"""

import numpy as np

from jaxcam.rays.rotations import rotvec_from_matrix

LIMITS = np.array(
    [[-2.8973, 2.8973], [-1.7628, 1.7628], [-2.8973, 2.8973], [-3.0718, -0.0698],
     [-2.8973, 2.8973], [-0.0175, 3.7525], [-2.8973, 2.8973]]
).T  # fmt: skip
"""Least and largest joint angles (rad) [2, 7], Franka's."""
_TURNS = np.array([0, -1, 1, 1, -1, 1, 1]) * np.pi / 2
"""Turn (rad) about x from each joint's frame to the next joint's (Franka's data sheet)."""
_SHIFTS = np.array(
    [[0, 0, 0.333], [0, 0, 0], [0, -0.316, 0], [0.0825, 0, 0], [-0.0825, 0.384, 0], [0, 0, 0],
     [0.088, 0, 0]]
)  # fmt: skip
"""Ways (m) from each joint's frame to the next joint's."""
_GRIP = 0.107 + 0.1034
"""Distance (m) from the last joint's frame along its axis to between the finger tips."""
_HAND_TURN = -np.pi / 4
"""Turn (rad) of the hand about that axis."""

ITERATIONS = 12
"""Enough for 1e-5 m from where a control step may begin."""
DAMPING = 1e-4
"""Added to the diagonal of J Jᵀ, as ManiSkill does: near singular poses steps stay small."""
REST = 0.05
"""Share of the way to the rest pose that the null space moves per iteration."""
LEAP = 0.5
"""Largest error (m and rad) that one iteration answers to."""


def forward(q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The grip of arms.

    Args:
        q: Joint angles (rad) [n, 7].

    Returns:
        Positions (m) [n, 3] and axes [n, 3, 3] in the base's frame, and Jacobians [n, 6, 7],
        translation above rotation.
    """
    count = len(q)
    rotation = np.tile(np.eye(3), (count, 1, 1))
    position = np.zeros((count, 3))
    axes, origins = np.empty((7, count, 3)), np.empty((7, count, 3))
    for i in range(7):
        position = position + rotation @ _SHIFTS[i]
        rotation = rotation @ _about_x(_TURNS[i]) @ _about_z(q[:, i])
        axes[i], origins[i] = rotation[:, :, 2], position
    position = position + _GRIP * rotation[:, :, 2]
    jacobian = np.concatenate([np.cross(axes, position - origins), axes], -1)
    rotation = rotation @ _about_z(np.array([_HAND_TURN]))
    return position, rotation, jacobian.transpose(1, 2, 0)


def inverse(
    position: np.ndarray, rotation: np.ndarray, q: np.ndarray, rest: np.ndarray
) -> np.ndarray:
    """Joint angles (rad) [n, 7] that bring grips to poses, or near to what is out of reach.

    Args:
        position: Targets (m) in the base's frame [n, 3].
        rotation: Target axes in the base's frame [n, 3, 3].
        q: Joint angles to begin from [n, 7].
        rest: Joint angles that what the pose leaves free is drawn to [n, 7].
    """
    for _ in range(ITERATIONS):
        at, axes, jacobian = forward(q)
        error = np.concatenate([position - at, rotvec_from_matrix(rotation @ axes.mT)], -1)
        for part in (error[:, :3], error[:, 3:]):
            part *= np.minimum(1, LEAP / np.maximum(np.linalg.norm(part, axis=-1), LEAP))[:, None]
        back = jacobian.mT @ np.linalg.inv(jacobian @ jacobian.mT + DAMPING * np.eye(6))
        free = REST * (rest - q)
        step = (back @ (error - (jacobian @ free[..., None])[..., 0])[..., None])[..., 0] + free
        q = np.clip(q + step, *LIMITS)
    return q


def _about_x(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def _about_z(angle: np.ndarray) -> np.ndarray:
    """Rotations [n, 3, 3] by angles [n]."""
    turn = np.zeros((len(angle), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
    turn[:, 1, 0] = np.sin(angle)
    turn[:, 0, 1] = -turn[:, 1, 0]
    turn[:, 2, 2] = 1
    return turn
