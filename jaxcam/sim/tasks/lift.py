"""Lift: pick a small cube up from the table."""

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from jaxcam.rays.rotations import Array
from jaxcam.sim.experts import CLOSE, OPEN, Hand
from jaxcam.sim.mujoco.objects import Box
from jaxcam.sim.mujoco.table import TABLE_TOP, TableTask
from jaxcam.sim.types import Aim, ExpertSight, Start, State
from jaxcam.sim.world import World

HALF_SIZE = (0.020, 0.022)
"""Range (m) of the cube's half-sizes, each side drawn by itself (robosuite, the authors)."""
PLACEMENT = 0.2
"""Half-range (m) of the cube's x and y on the table (authors' LiftRand)."""
GRASP, HOVER, FUNNEL = -0.004, 0.10, 0.012
"""The expert's heights over the cube's centre (m) at the grasp and, at most, on the way there, and
the distance to the side (m) within which it goes all the way down."""
LIFTED = 0.04
"""Height (m) of the cube's centre above the table that counts as lifted (robosuite)."""


class Lift(TableTask):
    """Lift (paper, section IV-A; robosuite's `Lift`, the authors' `LiftRand`)."""

    name: ClassVar[str] = "lift"
    prompt: ClassVar[str] = "Lift the cube"
    horizon: ClassVar[int] = 150
    views: ClassVar[int] = 1
    stair: ClassVar[tuple[int, int]] = (3, 1)
    varied: ClassVar[tuple[str, ...]] = ("cube_g0",)

    def objects(self) -> list[Box]:
        """One green cube."""
        half = sum(HALF_SIZE) / 2
        return [Box("cube", half_size=(half, half, half), rgba=(0.10, 0.62, 0.22, 1))]

    def place(self, scene: World, rng: np.random.Generator, start: Start) -> None:
        """Anywhere within 0.2 m of the table's centre, any yaw, 1 cm above the table."""
        start.geom_size[0] = half = rng.uniform(*HALF_SIZE, 3)
        qpos = start.qpos
        cube = scene.qpos_of("cube")
        yaw = rng.uniform(-np.pi, np.pi)
        qpos[cube : cube + 2] = rng.uniform(-PLACEMENT, PLACEMENT, 2)
        qpos[cube + 2] = TABLE_TOP + half[2] + 0.01
        qpos[cube + 3 : cube + 7] = [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]

    def success(self, scene: World, state: State, start: Start) -> Array:
        """The cube's centre is more than 4 cm above the table."""
        return state.qpos[..., scene.qpos_of("cube") + 2] > TABLE_TOP + LIFTED

    def expert(self, scene: World, sight: ExpertSight) -> Iterator[Aim]:
        """Down a funnel onto the cube, close, up; the gripper keeps the orientation it starts with.

        The farther off to the side the gripper is, the higher it stays, so that it neither hits
        the cube nor loses it when it has to correct.
        """
        cube = slice(scene.qpos_of("cube"), scene.qpos_of("cube") + 3)
        hand = Hand(sight)

        def funnel() -> np.ndarray:
            aside = np.linalg.norm((sight.grip_position - sight.qpos[cube])[:2])
            return sight.qpos[cube] + [0, 0, np.clip(3 * (aside - FUNNEL), GRASP, HOVER)]

        yield from hand.reach(funnel, OPEN, tolerance=0.008, stray=0.06)
        yield from hand.hold(CLOSE, steps=8)
        up = np.add(sight.grip_position, [0, 0, 0.12])
        yield from hand.reach(lambda: up, CLOSE, tolerance=0.02)
