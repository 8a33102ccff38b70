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
EASE = 0.35
"""Share of the way left that a set-point moves in one control step, when that is shorter."""
STRAY_STEPS = (2, 6)
"""Control steps for which a set-point strays, from and below."""
PATIENCE = 80
"""Control steps after which a move is given up."""


def reach(
    sight: Sight,
    goal: Callable[[], np.ndarray],
    rotation: np.ndarray,
    gripper: float,
    *,
    tolerance: float,
    stray: float = 0.0,
) -> Iterator[Aim]:
    """Moves the grip site to a goal (m, world), which may move, until it is within `tolerance`.

    The set-point covers the share `EASE` of what is left per step, at most `STEP`: fast far away,
    gentle on arrival.

    Args:
        sight: what is seen, renewed between aims.
        goal: where to.
        rotation: of the grip site.
        gripper: sign.
        tolerance: distance (m) at which the move ends.
        stray: chance per step to stray for a moment in a random direction. Corrections of such
            errors are what a policy must be shown to recover from its own.
    """
    point, astray, drift = sight.grip_position.copy(), 0, np.zeros(3)
    for _ in range(PATIENCE):
        left = goal() - point
        way = np.linalg.norm(left)
        move = left * min(EASE, STEP / max(way, 1e-9))
        if stray and not astray and sight.rng.random() < stray:
            astray = int(sight.rng.integers(*STRAY_STEPS))
            direction = sight.rng.normal(size=3)
            drift = STEP * sight.rng.random() * direction / np.linalg.norm(direction)
        if astray:
            astray, move = astray - 1, drift
        point = point + move
        yield Aim(point, rotation, gripper)
        if not astray and np.linalg.norm(goal() - sight.grip_position) < tolerance:
            return


def hold(
    position: np.ndarray, rotation: np.ndarray, gripper: float, *, steps: int
) -> Iterator[Aim]:
    """Keeps a pose for a number of control steps."""
    for _ in range(steps):
        yield Aim(position, rotation, gripper)
