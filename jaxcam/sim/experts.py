"""Moves that scripted experts are made of.

An expert is a generator of aims. It walks a set-point by bounded steps, so the recorded command is
smooth whatever the arm does, and waits for the arm where it matters.
"""

from collections.abc import Callable, Iterator

import numpy as np

from jaxcam.rays.rotations import matrix_from_rotvec, rotvec_from_matrix
from jaxcam.sim.types import Aim, ExpertSight

OPEN, CLOSE = -1.0, 1.0
STEP = 0.02
"""Longest way (m) that a set-point moves in one control step (authors' code)."""
EASE = 0.35
"""Share of the way left that a set-point moves in one control step, when that is shorter."""
TURN = 0.06
"""Largest turn (rad) of a set-point in one control step; faster, the arm swings (authors: 0.2)."""
STRAY_STEPS = (2, 6)
"""Control steps for which a set-point strays, from and below."""
SPIN = 0.2
"""Largest turn (rad) in one control step of a set-point that strays from its turn, too (authors'
limit of any turn, Square)."""
AIMED = 0.1
"""Angle (rad) between grip and goal that is near enough (authors' code, Square)."""
PATIENCE = 80
"""Control steps after which a move is given up."""


LEVEL, LEAN = 0.58, 1.0
"""Distance (m) from the robot's base at which a hand points straight down, and the angle (rad) by
which it leans away per metre beyond."""
CLOSE_BY, FAR, STRETCH = 0.36, 0.72, 3.0
"""Distances (m) within which a pushing hand leans towards the robot by so much (rad/m), or the
wrist would be at the end of its range, and beyond which any hand leans away by so much more, or the
elbow would be straight."""
INSIDE, SLOPE = 0.012, 4.0
"""Of a funnel: distance to the side (m) within which a hand goes all the way down, and the height
of the wall over the distance from there."""


def funnel(
    offset: np.ndarray, low: float, high: float, *, inside: float = INSIDE, slope: float = SLOPE
) -> float:
    """Height (m) at which to be, `offset` (m) [3] being how far off one is.

    The farther off to the side, the higher: what is approached is neither hit nor lost when the
    hand has to correct.
    """
    aside = float(np.linalg.norm(offset[:2]))
    return float(np.clip(low + slope * (aside - inside), low, high))


def easy_grip(base: np.ndarray, at: np.ndarray, close: np.ndarray) -> np.ndarray:
    """Grip axes [3, 3] of a hand that points down and closes along a horizontal direction.

    The hand leans a little about that direction, towards the robot when near to it and away when
    far: so it is within reach, and out of line with the forearm, where the arm swings.

    Args:
        base: Position of the robot's base (m) [3].
        at: Where the grip is (m) [3].
        close: The direction [3].
    """
    out = (at - base)[:2]
    distance = np.linalg.norm(out)
    x, y = close[:2] / np.linalg.norm(close[:2])
    lean = LEAN * (distance - LEVEL) + STRETCH * max(0, distance - FAR)
    lean = lean * (out @ [y, -x]) / distance
    across = np.array([x, y, 0.0])
    down = np.array([np.sin(lean) * y, -np.sin(lean) * x, -np.cos(lean)])
    return np.stack([across, np.cross(down, across), down], -1)


class Hand:
    """The set-point of an expert's gripper, which moves from where it is and never jumps.

    Args:
        sight: What the expert sees, renewed between aims; the set-point starts at its grip pose
            and keeps that orientation.

    Attributes:
        errs: Whether its aims err on purpose (`Aim.error`).
    """

    def __init__(self, sight: ExpertSight) -> None:
        self._sight = sight
        self._point = sight.grip_position.copy()
        self._rotation = sight.grip_rotation.copy()
        self.errs = False

    def reach(
        self,
        goal: Callable[[], np.ndarray],
        gripper: float,
        *,
        tolerance: float,
        turn: Callable[[], np.ndarray] | None = None,
        trim: float = 0.0,
        stray: float = 0.0,
        spin: float = 0.0,
    ) -> Iterator[Aim]:
        """Moves towards a goal (m, world), which may move, until the grip is within `tolerance`.

        The set-point covers the share `EASE` of what is left per step, at most `STEP`: fast far
        away, gentle on arrival. So it turns, by at most `TURN`.

        Args:
            goal: Where to.
            gripper: Sign of the gripper's command.
            tolerance: Distance (m) between grip and goal at which the move ends.
            turn: Grip axes [3, 3] to turn to meanwhile, to within `AIMED`; none keeps them.
            trim: Share of what the arm, whose joints stick, stays behind by which the set-point
                goes on per step, once it is there itself.
            stray: Chance per step to stray for a moment in a random direction. Corrections of
                such errors are what a policy must be shown to recover from its own.
            spin: Largest turn (rad) per step, about the vertical, of a set-point that strays; 0
                goes on turning to `turn`. A policy that is shown hands which always turn the right
                way reads the turn off its own joints.
        """
        rng, astray, drift, extra = self._sight.rng, 0, np.zeros(3), np.zeros(3)
        twist = np.zeros(3)
        for _ in range(PATIENCE):
            way = goal() + extra - self._point
            if trim and np.linalg.norm(way) < STEP / 2:
                extra = extra + trim * (goal() - self._sight.grip_position)
            move = way * min(EASE, STEP / max(np.linalg.norm(way), 1e-9))
            if stray and not astray and rng.random() < stray:
                astray = int(rng.integers(*STRAY_STEPS))
                direction = rng.normal(size=3)
                drift = STEP * rng.random() * direction / np.linalg.norm(direction)
                twist[2] = rng.uniform(-spin, spin) if spin else 0
            if astray and spin:
                self._rotation = matrix_from_rotvec(twist) @ self._rotation
            elif turn is not None:
                self._turn(turn())
            if astray:
                astray, move = astray - 1, drift
            yield self._move(move, gripper)
            near = np.linalg.norm(goal() - self._sight.grip_position) < tolerance
            if near and not astray and (turn is None or self._angle(turn()) < AIMED):
                return

    def hold(self, gripper: float, *, steps: int) -> Iterator[Aim]:
        """Keeps the set-point for a number of control steps."""
        for _ in range(steps):
            yield self._move(np.zeros(3), gripper)

    def _move(self, move: np.ndarray, gripper: float) -> Aim:
        self._point = self._point + move
        return Aim(self._point, self._rotation, gripper, self.errs)

    def _turn(self, goal: np.ndarray) -> None:
        turn = rotvec_from_matrix(goal @ self._rotation.T)
        turn = turn * min(EASE, TURN / max(np.linalg.norm(turn), 1e-9))
        self._rotation = matrix_from_rotvec(turn) @ self._rotation

    def _angle(self, goal: np.ndarray) -> float:
        """How far (rad) the grip is turned from `goal`."""
        return float(np.linalg.norm(rotvec_from_matrix(goal @ self._sight.grip_rotation.T)))


def pushing_grip(
    base: np.ndarray, at: np.ndarray, along: np.ndarray, like: np.ndarray
) -> np.ndarray:
    """Grip axes [3, 3] of a hand that points down and whose closed fingers push broadside.

    Its fingers close (along the y axis, as ManiSkill's do) across the direction; of the two ways,
    the one that is turned less. Near to the robot the hand leans towards it, far off away.

    Args:
        base: Position of the robot's base (m) [3].
        at: Where the grip is (m) [3].
        along: Horizontal direction [2] or [3] to push in.
        like: Grip axes [3, 3] to be near to.
    """
    x, y = along[:2] / np.linalg.norm(along[:2])
    across = np.array([-y, x, 0.0])
    if across @ like[:, 1] < 0:
        across = -across
    down = np.array([0.0, 0.0, -1.0])
    upright = np.stack([np.cross(across, down), across, down], -1)
    out = np.array([*(at - base)[:2], 0.0])
    distance = float(np.linalg.norm(out))
    lean = STRETCH * (max(0.0, distance - FAR) - max(0.0, CLOSE_BY - distance))
    return matrix_from_rotvec(lean * np.cross(down, out / distance)) @ upright
