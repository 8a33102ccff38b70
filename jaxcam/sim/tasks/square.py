"""Assembly Square: put the square nut over the peg."""

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from jaxcam.rays.rotations import Array, array_namespace, matrix_from_rotvec
from jaxcam.sim.experts import CLOSE, OPEN, SPIN, Hand, easy_grip, funnel
from jaxcam.sim.mujoco.objects import Compound, Piece, SquareNut
from jaxcam.sim.mujoco.table import TABLE_TOP, TableTask
from jaxcam.sim.types import Aim, ExpertSight, Start, State
from jaxcam.sim.world import World

NUT_HALF_HEIGHT, HANDLE = 0.010, 0.054
"""Of robosuite's nut (m), its origin being the middle of the hole: half its thickness, and how far
along its x axis the handle's middle is."""
PEG_RADIUS, PEG_HALF_LENGTH = 0.012, 0.05
BASE_HALF_SIZE = (0.06, 0.06, 0.005)
DENSITY = 2000.0
"""The peg on its base (m, kg/m³), which stands freely (authors' SquareRand)."""
PEG_TOP = 2 * (BASE_HALF_SIZE[2] + PEG_HALF_LENGTH)
"""Height (m) of the peg above the table."""
PLACEMENT = 0.18
"""Half-range (m) of x and y of nut and peg on the table (authors' SquareRand)."""
APART = 0.17
"""Least distance (m) between nut and peg at the start: the nut's handle never lies on the base,
whatever the yaws (the authors let it, from 0.137)."""
AROUND, LOW = 0.03, 0.1
"""Distance (m) along x and along y between nut and peg, and height (m) of the nut above the table,
below which it sits on the peg (authors' SquareRand)."""
AWAY = float(np.arctanh(0.4) / 10)
"""Distance (m) from the grip at which something is let go: 1 - tanh(10 d) < 0.6 (robosuite)."""
GRIP, GRASP, HOVER = 0.062, 0.003, 0.12
"""Where the expert grips the nut (m): how far along its x axis and over its middle, and how high
above that it comes from."""
REACH = 0.72
"""Distance (m) from the robot's base up to which an upright hand works well."""
MISSES, MISS, ASKEW = 0.5, 0.02, 1.0
"""Share of the demonstrations that grip badly first, and how badly: deviation (m) of the place
along x and along y, and largest angle (rad)."""
ON_IT = np.zeros(3)
"""Deviation (m) of a good grip."""
WELL_HELD, STRAIGHT, LAID = 0.012, 0.35, 0.02
"""A nut is well held that is within so much (m) of its place in the grip, and as straight (sine of
the angle); else it is laid down, with the grip so high (m) above the table."""
UP, OVER, DOWN = 0.07, 0.16, 0.026
"""Heights (m) of the nut above the table when lifted, over the peg, and when let go."""


def _peg() -> Compound:
    """A cylinder on a square base; it collides as a capsule, which any engine does with boxes."""
    length, middle = 2 * PEG_HALF_LENGTH, (0, 0, PEG_HALF_LENGTH + BASE_HALF_SIZE[2])
    filled = 1 - 2 / 3 * PEG_RADIUS / length  # capsule's volume over the cylinder's
    rod, stick = (PEG_RADIUS, PEG_HALF_LENGTH - PEG_RADIUS), (PEG_RADIUS, PEG_HALF_LENGTH)
    return Compound(
        name="peg",
        half_size=(*BASE_HALF_SIZE[:2], PEG_HALF_LENGTH + BASE_HALF_SIZE[2]),
        pieces=(
            Piece("base", "box", BASE_HALF_SIZE, (0, 0, 0), DENSITY),
            Piece("rod", "capsule", rod, middle, DENSITY / filled, "collision"),
            Piece("stick", "cylinder", stick, middle, None, "visual"),
        ),
        rgba=(0.22, 0.36, 0.62, 1),
    )


class Square(TableTask):
    """Assembly Square (paper, section IV-A; robosuite's nut, the authors' `SquareRand`)."""

    name: ClassVar[str] = "square"
    prompt: ClassVar[str] = "Pick up the square nut and insert the peg into it"
    horizon: ClassVar[int] = 600
    views: ClassVar[int] = 2
    stair: ClassVar[tuple[int, int]] = (4, 2)

    def objects(self) -> list[SquareNut | Compound]:
        """A square nut with a handle, and a peg."""
        return [SquareNut("nut"), _peg()]

    def place(self, scene: World, rng: np.random.Generator, start: Start) -> None:
        """Both within 0.18 m of the table's centre, 0.17 m apart; the nut 1 cm above the table."""
        place = rng.uniform(-PLACEMENT, PLACEMENT, (2, 2))
        while np.linalg.norm(place[0] - place[1]) < APART:
            place = rng.uniform(-PLACEMENT, PLACEMENT, (2, 2))
        heights = NUT_HALF_HEIGHT + 0.01, BASE_HALF_SIZE[2]
        for name, (x, y), height in zip(("nut", "peg"), place, heights, strict=True):
            at, yaw = scene.qpos_of(name), rng.uniform(-np.pi, np.pi)
            start.qpos[at : at + 3] = x, y, TABLE_TOP + height
            start.qpos[at + 3 : at + 7] = [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]

    def success(self, scene: World, state: State, start: Start) -> Array:
        """The nut is around the peg and low, and the gripper away from its middle and its handle.

        robosuite and the authors measure the gripper's distance from the nut's middle alone, which
        a hand that still holds the handle passes.
        """
        xp = array_namespace(state.qpos)
        nut, peg = scene.qpos_of("nut"), scene.qpos_of("peg")
        middle = state.qpos[..., nut : nut + 3]
        handle = middle + HANDLE * _x_axis(state.qpos[..., nut + 3 : nut + 7])
        aside = xp.abs(middle - state.qpos[..., peg : peg + 3])
        around = (aside[..., 0] < AROUND) & (aside[..., 1] < AROUND)
        for point in (middle, handle):
            distance = xp.sqrt(((state.grip_position - point) ** 2).sum(-1))
            around = around & (distance > AWAY)
        return around & (middle[..., 2] < TABLE_TOP + LOW)

    def expert(self, scene: World, sight: ExpertSight) -> Iterator[Aim]:
        """Turn over the handle, down, close, up, over the peg, down around it, open, away.

        Often it first grips beside the handle or askew, which it says are errors, sees that, puts
        down what it holds and grips again: so policies are shown how to go on from bad grips of
        their own.
        """
        peg, nut = scene.qpos_of("peg"), _NutGripper(scene, sight)
        hand, rng = nut.hand, sight.rng

        def over_peg() -> np.ndarray:
            there = np.array([*sight.qpos[peg : peg + 2], TABLE_TOP])
            off = nut.middle - there
            threaded = off[2] < PEG_TOP and np.linalg.norm(off[:2]) < AROUND
            height = DOWN if threaded else funnel(off, DOWN, OVER, inside=0.008, slope=20)
            return sight.grip_position - off + [0, 0, height]

        erring = rng.random() < MISSES
        if erring:
            miss, askew = np.array([*rng.normal(0, MISS, 2), 0]), rng.uniform(-ASKEW, ASKEW)
            yield from nut.approach()
            yield from nut.grip_badly(miss, askew)
        if not nut.is_held():
            if erring:
                yield from nut.lay_down()
            yield from nut.approach()
            yield from nut.grip(ON_IT, 0, tolerance=0.008)
        close = sight.grip_rotation[:, 0]
        turned = _over_peg(nut.base, sight.qpos[peg : peg + 3], close, nut.along())
        yield from hand.reach(
            over_peg,
            CLOSE,
            tolerance=0.007,
            turn=lambda: easy_grip(nut.base, sight.grip_position, turned),
            trim=0.05,
        )
        yield from hand.hold(OPEN, steps=6)
        away = np.add(sight.grip_position, [0, 0, HOVER])
        yield from hand.reach(lambda: away, OPEN, tolerance=0.03)


class _NutGripper:
    """The expert's ways of gripping the nut by its handle, and of letting it go again."""

    def __init__(self, scene: World, sight: ExpertSight) -> None:
        self.hand = Hand(sight)
        self.base = scene.world_from_base[:3, 3]
        self._sight, self._nut = sight, scene.qpos_of("nut")

    @property
    def middle(self) -> np.ndarray:
        """Of the nut (m) [3]."""
        return self._sight.qpos[self._nut : self._nut + 3]

    def along(self) -> np.ndarray:
        """The direction [3] from its middle to its handle."""
        return _x_axis(self._sight.qpos[self._nut + 3 : self._nut + 7])

    def is_held(self) -> bool:
        """Whether the hand is where, and as, it grips well."""
        off = np.linalg.norm(self._sight.grip_position - self._grasp())
        askew = abs(self._sight.grip_rotation[:, 0] @ self.along())
        return bool(off < WELL_HELD and askew < STRAIGHT)

    def approach(self) -> Iterator[Aim]:
        """Until over the handle and turned across it, straying on the way."""
        yield from self.hand.reach(
            lambda: self._over(ON_IT, HOVER),
            OPEN,
            tolerance=0.04,
            turn=lambda: self._across(0),
            stray=0.06,
            spin=SPIN,
        )

    def grip(self, miss: np.ndarray, askew: float, *, tolerance: float) -> Iterator[Aim]:
        """Down, close and up.

        Args:
            miss: How far (m) beside the handle [3].
            askew: Angle (rad) by which it grips it askew.
            tolerance: How near (m) to that it closes.
        """
        yield from self.hand.reach(
            lambda: self._over(miss),
            OPEN,
            tolerance=tolerance,
            turn=lambda: self._across(askew),
            trim=0.05,
        )
        yield from self.hand.hold(CLOSE, steps=9)
        up = np.array([*self._sight.grip_position[:2], TABLE_TOP + UP])
        yield from self.hand.reach(lambda: up, CLOSE, tolerance=0.03)

    def grip_badly(self, miss: np.ndarray, askew: float) -> Iterator[Aim]:
        """Aside and askew while still high, so that the nut is not hit, then as `grip`: errors."""
        self.hand.errs = True
        yield from self.hand.reach(
            lambda: self._over(miss, HOVER),
            OPEN,
            tolerance=0.04,
            turn=lambda: self._across(askew),
        )
        yield from self.grip(miss, askew, tolerance=0.025)
        self.hand.errs = False

    def lay_down(self) -> Iterator[Aim]:
        """Down where it is, if it holds the nut up, and open."""
        down = np.array([*self._sight.grip_position[:2], TABLE_TOP + LAID])
        if self.middle[2] > TABLE_TOP + UP / 2:
            yield from self.hand.reach(lambda: down, CLOSE, tolerance=0.02)
        yield from self.hand.hold(OPEN, steps=4)

    def _grasp(self) -> np.ndarray:
        return self.middle + GRIP * self.along() + [0, 0, GRASP]

    def _over(self, miss: np.ndarray, least: float = 0) -> np.ndarray:
        there = self._grasp() + miss
        return np.add(there, [0, 0, funnel(self._sight.grip_position - there, least, HOVER)])

    def _across(self, askew: float) -> np.ndarray:
        at, close = self._sight.grip_position, np.cross([0, 0, 1], self.along())
        close = -close if _twist(self.base, at, close) > np.pi / 2 else close
        turned = matrix_from_rotvec(np.array([0, 0, askew])) @ close
        return easy_grip(self.base, at, turned)


def _over_peg(
    base: np.ndarray, peg: np.ndarray, close: np.ndarray, along: np.ndarray
) -> np.ndarray:
    """The direction [3] in which a hand closes that holds the nut over the peg.

    The peg is round: of all directions that the handle may have there, the best compromise of
    little turning, an untwisted wrist and being within reach.
    """

    def about(turn: float) -> np.ndarray:
        return matrix_from_rotvec(np.array([0, 0, turn]))

    def cost(turn: float) -> float:
        at = peg + GRIP * about(turn) @ along
        beyond = max(0.0, float(np.linalg.norm((at - base)[:2])) - REACH)
        return abs(turn) / 2 + _twist(base, at, about(turn) @ close) ** 2 + 30 * beyond

    return about(min(np.linspace(-np.pi, np.pi, 49), key=cost)) @ close


def _twist(base: np.ndarray, at: np.ndarray, close: np.ndarray) -> float:
    """Angle (rad) by which a hand that closes along `close` is turned against the arm."""
    sideways = np.cross([0, 0, 1], at - base)
    return float(np.arccos(np.clip(sideways @ close / np.linalg.norm(sideways), -1, 1)))


def _x_axis(quaternion: Array) -> Array:
    """The x axis [..., 3] of a body with quaternion wxyz [..., 4]."""
    w, x, y, z = (quaternion[..., i] for i in range(4))
    xp = array_namespace(quaternion)
    return xp.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], -1)
