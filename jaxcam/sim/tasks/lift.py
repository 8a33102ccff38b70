"""Lift: pick a small cube up from the table."""

from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np

from jaxcam.rotations import Array
from jaxcam.sim.experts import CLOSE, OPEN, hold, reach
from jaxcam.sim.scene import TABLE_TOP, BoxObject, Scene
from jaxcam.sim.task import Aim, Sight, Task

HALF_SIZE = (0.020, 0.022)
"""Range (m) of the cube's half-sizes, each side drawn by itself (robosuite, the authors)."""
PLACEMENT = 0.2
"""Half-range (m) of the cube's x and y on the table (authors' LiftRand)."""
LIFTED = 0.04
"""Height (m) of the cube's centre above the table that counts as lifted (robosuite)."""


class Lift(Task):
    """Lift (paper, section IV-A; robosuite's `Lift`, the authors' `LiftRand`)."""

    name: ClassVar[str] = "lift"
    horizon: ClassVar[int] = 150
    views: ClassVar[int] = 1
    stair: ClassVar[tuple[int, int]] = (3, 1)
    varied: ClassVar[tuple[str, ...]] = ("cube_g0",)

    def objects(self) -> list[Any]:
        """One green cube."""
        middle = [sum(HALF_SIZE) / 2] * 3
        return [BoxObject(name="cube", size=middle, rgba=[0.10, 0.62, 0.22, 1])]

    def place(self, scene: Scene, rng: np.random.Generator, qpos: np.ndarray) -> np.ndarray:
        """Anywhere within 0.2 m of the table's centre, any yaw, 1 cm above the table."""
        half = rng.uniform(*HALF_SIZE, 3)
        cube = scene.qpos_of("cube")
        yaw = rng.uniform(-np.pi, np.pi)
        qpos[cube : cube + 2] = rng.uniform(-PLACEMENT, PLACEMENT, 2)
        qpos[cube + 2] = TABLE_TOP + half[2] + 0.01
        qpos[cube + 3 : cube + 7] = [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
        return half[None]

    def success(self, scene: Scene, qpos: Array) -> Array:
        """The cube's centre is more than 4 cm above the table."""
        return qpos[..., scene.qpos_of("cube") + 2] > TABLE_TOP + LIFTED

    def expert(self, scene: Scene, sight: Sight) -> Iterator[Aim]:
        """Over the cube, down, close, up; the gripper keeps the orientation it starts with."""
        cube = slice(scene.qpos_of("cube"), scene.qpos_of("cube") + 3)
        rotation = sight.grip_rotation.copy()

        def above(height: float) -> np.ndarray:
            return sight.qpos[cube] + [0, 0, height]

        yield from reach(sight, lambda: above(0.08), rotation, OPEN, tolerance=0.02)
        yield from reach(sight, lambda: above(-0.005), rotation, OPEN, tolerance=0.01)
        place = above(-0.005)
        yield from hold(place, rotation, CLOSE, steps=10)
        yield from reach(sight, lambda: place + [0, 0, 0.15], rotation, CLOSE, tolerance=0.02)
