"""Moves that scripted experts are made of.

An expert is a generator of aims. `reach` walks its own set-point towards a goal by bounded steps,
so the recorded command is smooth whatever the arm does, and waits for the arm at the end.
"""

from collections.abc import Callable, Iterator

import numpy as np

from jaxcam.sim.task import Aim, Sight

OPEN, CLOSE = -1.0, 1.0
STEP = 0.02
"""Longest way (m) that a set-point moves in one control step (authors' code)."""
PATIENCE = 60
"""Control steps after which a move is given up."""


def reach(
    sight: Sight,
    goal: Callable[[], np.ndarray],
    rotation: np.ndarray,
    gripper: float,
    *,
    tolerance: float,
    ease: float = 0.35,
) -> Iterator[Aim]:
    """Moves the grip site to a goal (m, world), which may move, until it is within `tolerance`.

    The set-point covers the share `ease` of what is left per step, at most `STEP`: fast far away,
    gentle on arrival.
    """
    point = sight.grip_position.copy()
    for _ in range(PATIENCE):
        left = goal() - point
        way = np.linalg.norm(left)
        point = point + left * min(ease, STEP / max(way, 1e-9))
        yield Aim(point, rotation, gripper)
        if np.linalg.norm(goal() - sight.grip_position) < tolerance:
            return


def hold(position: np.ndarray, rotation: np.ndarray, gripper: float, *, steps: int) -> Iterator[Aim]:
    """Keeps a pose for a number of control steps."""
    for _ in range(steps):
        yield Aim(position, rotation, gripper)
