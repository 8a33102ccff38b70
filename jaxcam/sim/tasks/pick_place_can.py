"""Pick Place Can: put the can where its ghost stands."""

from collections.abc import Iterator, Mapping
from typing import ClassVar

import numpy as np

from jaxcam.rays.rotations import Array, array_namespace
from jaxcam.sim.experts import CLOSE, OPEN, Hand, easy_grip, funnel
from jaxcam.sim.mujoco.objects import Can, CanGhost, prism
from jaxcam.sim.mujoco.table import TABLE_TOP, TableTask
from jaxcam.sim.types import Aim, ExpertSight, Start, State
from jaxcam.sim.world import World

RADIUS, HALF_HEIGHT = 0.026, 0.040
"""Of robosuite's can (m); its origin is its centre."""
GHOST_SIZE, GHOST_COLOUR = 0.85, (0.42, 0.74, 0.92, 1.0)
"""The ghost is smaller, so that the can hides it in the end: the ray tracer draws it solid."""
PLACEMENT = 0.2
"""Half-range (m) of x and y of can and target on the table (authors' CanRand)."""
APART = 0.15
"""Least distance (m) between can and target at the start (authors' CanRand)."""
NEAR = 0.05
"""Distance (m) to the side between can and target that counts as placed (authors' CanRand)."""
LOW = 0.1
"""Height (m) above the table below which the can's centre must be, but above the table itself."""
GRASP, HOVER, CARRY = 0.020, 0.12, 0.08
"""The expert's heights (m): the grip over the can's centre at the grasp and, at most, on the way
there, and the lifted can over where it is to stand."""
PRESS = 0.004
"""How far (m) below the table the expert lowers the can towards, so that it stands when let go."""


class PickPlaceCan(TableTask):
    """Pick Place Can (paper, section IV-A; robosuite's can, the authors' `CanRand`)."""

    name: ClassVar[str] = "pick_place_can"
    prompt: ClassVar[str] = "Move the can to the target"
    horizon: ClassVar[int] = 600
    views: ClassVar[int] = 2
    stair: ClassVar[tuple[int, int]] = (4, 2)
    markers: ClassVar[tuple[str, ...]] = ("target",)
    hulls: ClassVar[Mapping[str, np.ndarray]] = {"can_g0": prism(RADIUS, HALF_HEIGHT, 8)}

    def objects(self) -> list[Can | CanGhost]:
        """The can, and its ghost where it belongs."""
        return [Can("can"), CanGhost("target", scale=GHOST_SIZE, rgba=GHOST_COLOUR)]

    def place(self, scene: World, rng: np.random.Generator, start: Start) -> None:
        """Both within 0.2 m of the table's centre, 0.15 m apart; the can 1 cm above the table."""
        place = rng.uniform(-PLACEMENT, PLACEMENT, (2, 2))
        while np.linalg.norm(place[0] - place[1]) < APART:
            place = rng.uniform(-PLACEMENT, PLACEMENT, (2, 2))
        can, yaw = scene.qpos_of("can"), rng.uniform(-np.pi, np.pi)
        start.qpos[can : can + 3] = *place[0], TABLE_TOP + HALF_HEIGHT + 0.01
        start.qpos[can + 3 : can + 7] = [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
        start.fixtures[2, :3] = *place[1], TABLE_TOP + HALF_HEIGHT

    def success(self, scene: World, state: State, start: Start) -> Array:
        """The can is within 5 cm of the target to the side, and no higher than a hand's width."""
        can = scene.qpos_of("can")
        xp = array_namespace(state.qpos)
        aside = state.qpos[..., can : can + 2] - start.fixtures[..., 2, :2]
        height = state.qpos[..., can + 2] - TABLE_TOP
        return (xp.sqrt((aside**2).sum(-1)) <= NEAR) & (height > 0) & (height < LOW)

    def expert(self, scene: World, sight: ExpertSight) -> Iterator[Aim]:
        """Over the can, down, close, up, over the target, down, open, away."""
        can = slice(scene.qpos_of("can"), scene.qpos_of("can") + 3)
        target = sight.start.fixtures[2, :3] - [0, 0, PRESS]
        hand = Hand(sight)

        def over_can() -> np.ndarray:
            height = funnel(sight.grip_position - sight.qpos[can], GRASP, HOVER)
            return sight.qpos[can] + [0, 0, height]

        def over_target() -> np.ndarray:
            height = funnel(sight.qpos[can] - target, 0, CARRY, inside=0.02)
            return sight.grip_position + target - sight.qpos[can] + [0, 0, height]

        def turned(mix: float) -> np.ndarray:
            at = first + mix * (target - first)
            return easy_grip(scene.world_from_base[:3, 3], at, np.array([0.0, 1.0, 0.0]))

        # Not quite as is easy at the can and at the target: else it would be set down tilted.
        first = sight.qpos[can].copy()
        here, there = turned(0.3), turned(0.7)

        def above_can() -> np.ndarray:
            return np.add(sight.qpos[can], [0, 0, HOVER])

        yield from hand.reach(above_can, OPEN, tolerance=0.04, turn=lambda: here, stray=0.06)
        yield from hand.reach(over_can, OPEN, tolerance=0.008, turn=lambda: here, trim=0.05)
        yield from hand.hold(CLOSE, steps=8)
        up = np.add(sight.grip_position, [0, 0, CARRY])
        yield from hand.reach(lambda: up, CLOSE, tolerance=0.03)
        yield from hand.reach(over_target, CLOSE, tolerance=0.012, turn=lambda: there, trim=0.05)
        yield from hand.hold(OPEN, steps=6)
        away = np.add(sight.grip_position, [0, 0, HOVER])
        yield from hand.reach(lambda: away, OPEN, tolerance=0.03)
