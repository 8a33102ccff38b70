"""What observations and actions of an environment look like, as Gymnasium's spaces."""

import numpy as np
from gymnasium import spaces

from jaxcam.sim.actions import action_dim, is_absolute, is_joint
from jaxcam.sim.world import World

STEP, TURN = 0.05, 0.5
"""Farthest (m) and largest turn (rad) of one control step in each direction: robosuite's. The
experts' demonstrations have 0.02 and 0.06, of joints up to 0.25."""
REACH = 1.0
"""Distance (m) from the robot's base along each axis within which its hand stays: a Panda's reach
is 0.86 m."""
WHOLE_TURN = float(2 * np.pi)
"""Longest rotation vector (rad). Those of `eef_abs` are longer than half a turn where the way led
there, and differences of `eef_delta_componentwise` jump by up to so much."""
JOINTS = np.array(
    [
        [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973],
        [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973],
    ]
)
"""Least and largest angles (rad) of the Panda's joints (Franka's data sheet)."""
OPENING = 0.2
"""No gripper opens as wide (m)."""


def observations(K: np.ndarray, views: int, height: int, width: int) -> spaces.Dict:
    """Observations of one world.

    Args:
        K: Intrinsics of its cameras, in pixels [3, 3].
        views: How many cameras.
        height: Of the pictures (pixels).
        width: Of the pictures (pixels).
    """
    proprio = np.array([*[WHOLE_TURN] * 7, *[2 * REACH] * 3, OPENING], np.float32)
    least = np.where(proprio == np.float32(OPENING), 0, -proprio)
    return spaces.Dict(
        {
            "image": spaces.Box(0, 255, (views, height, width, 3), np.uint8),
            "K": spaces.Box(0, float(np.ceil(K.max())), (views, 3, 3), np.float32),
            "base_from_camera": spaces.Box(-FAR, FAR, (views, 4, 4), np.float32),
            "state": spaces.Box(least, proprio, dtype=np.float32),
        }
    )


FAR = 10.0
"""No camera of the tasks is as far (m) from the robot's base."""


def actions(space: str, world: World, chunk: int | None) -> spaces.Box:
    """Actions of one world, in the units of their space: m, rad, and the gripper's sign.

    Actions beyond the bounds are executed as they are, as rollouts do.

    Args:
        space: Of the actions, see `jaxcam.sim.actions`.
        world: Where they are executed.
        chunk: Actions at once; one, without an axis, when None.
    """
    size = action_dim(space) - 1
    if is_joint(space):
        low, high = JOINTS if is_absolute(space) else (np.full(size, -TURN), np.full(size, TURN))
    else:
        turn = TURN if space == "eef_delta" else WHOLE_TURN
        high = np.array([*[REACH if is_absolute(space) else STEP] * 3, *[turn] * 3])
        low = -high
        if is_absolute(space):
            base = np.array([*world.world_from_base[:3, 3], 0, 0, 0])
            low, high = base + low, base + high
    bounds = [np.append(bound, grip) for bound, grip in ((low, -1), (high, 1))]
    if chunk is not None:
        bounds = [np.tile(bound, (chunk, 1)) for bound in bounds]
    return spaces.Box(*(bound.astype(np.float32) for bound in bounds), dtype=np.float32)
