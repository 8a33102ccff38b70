"""Lift Upright: stand a lying peg up."""

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from jaxcam.rays import POSE_RANGES, PoseRanges
from jaxcam.rays.rotations import Array, matrix_from_quaternion, matrix_from_rotvec
from jaxcam.sim.experts import CLOSE, OPEN, Hand, pushing_grip
from jaxcam.sim.maniskill.task import ManiSkillTask
from jaxcam.sim.types import Aim, ExpertSight, Start, State
from jaxcam.sim.world import World

HALF_LENGTH, HALF_WIDTH = 0.12, 0.025
"""Of the peg (m), ManiSkill's; it is as high as wide and long along its x axis."""
PLACEMENT, MIDDLE = 0.1, (-0.1, 0.0)
"""Half-range and middle (m) of the peg's x and y (authors' LiftPegUprightRand)."""
UPRIGHT = float(np.cos(np.deg2rad(20.0)))
"""Cosine of the angle to the vertical within which the peg stands (authors)."""
GRIP, HOVER = 0.06, 0.10
"""Where the expert grips (m): how far from the peg's middle, and how high it comes from."""
REACH = 0.46
"""Distance (m) from the robot's base to which the peg is brought before it is turned: the hand then
points at the robot from behind the peg."""
FREE = 0.03
"""Height (m) of the peg's foot over the table while it is turned."""
TILT = float(np.deg2rad(88.0))
"""Angle by which the expert turns it: what is missing, the table adds."""


class LiftUpright(ManiSkillTask):
    """Lift Upright (paper, section IV-A; ManiSkill's `LiftPegUpright`, the authors' variant)."""

    name: ClassVar[str] = "lift_upright"
    prompt: ClassVar[str] = "Lift the peg upright"
    env: ClassVar[str] = "JaxcamLiftUpright-v1"
    horizon: ClassVar[int] = 450
    views: ClassVar[int] = 1
    stair: ClassVar[tuple[int, int]] = (3, 1)
    cameras: ClassVar[PoseRanges] = POSE_RANGES["maniskill_lift_upright"]
    fovy_deg: ClassVar[float] = float(np.rad2deg(1.0))

    def objects(self) -> list[str]:
        """The peg, by ManiSkill's name."""
        return ["peg"]

    def place(self, scene: World, rng: np.random.Generator, start: Start) -> None:
        """Flat on the table, within 0.1 m of a point before the robot, any yaw."""
        peg = scene.qpos_of("peg")
        start.qpos[peg : peg + 2] = np.add(MIDDLE, rng.uniform(-PLACEMENT, PLACEMENT, 2))
        start.qpos[peg + 2] = HALF_WIDTH
        # A yaw after the quarter turn about x that ManiSkill lays it with.
        half = rng.uniform(-np.pi, np.pi) / 2
        turned = [np.cos(half), np.cos(half), np.sin(half), np.sin(half)]
        start.qpos[peg + 3 : peg + 7] = np.sqrt(0.5) * np.array(turned)

    def success(self, scene: World, state: State, start: Start) -> Array:
        """The peg is within 20° of the vertical, either end up, at any height (authors)."""
        peg = scene.qpos_of("peg")
        w, x, y, z = (state.qpos[..., peg + 3 + i] for i in range(4))
        return abs(2 * (x * z - w * y)) > UPRIGHT

    def expert(self, scene: World, sight: ExpertSight) -> Iterator[Aim]:
        """Over the peg's nearer half, down, close, up, turn towards the robot, down, open.

        Turned the other way, the wrist would be at the end of its range.
        """
        at, base = scene.qpos_of("peg"), scene.world_from_base[:3, 3]
        hand = Hand(sight)
        near = _x_axis(sight.qpos[at + 3 : at + 7])
        if near @ (base - sight.qpos[at : at + 3]) < 0:
            near = -near
        flat = pushing_grip(base, sight.qpos[at : at + 3], near, sight.grip_rotation)
        turned = matrix_from_rotvec(np.cross([0, 0, -1], near) * TILT) @ flat

        def over(height: float) -> np.ndarray:
            return sight.qpos[at : at + 3] + GRIP * near + [0, 0, height]

        yield from hand.reach(
            lambda: over(HOVER), OPEN, tolerance=0.03, turn=lambda: flat, stray=0.06
        )
        yield from hand.reach(lambda: over(0), OPEN, tolerance=0.008, turn=lambda: flat)
        yield from hand.hold(CLOSE, steps=8)
        foot = GRIP + HALF_LENGTH
        out = (sight.grip_position - base)[:2]
        out = out * min(1.0, REACH / float(np.linalg.norm(out)))
        up = np.array([*(base[:2] + out), foot + FREE])
        yield from hand.reach(lambda: up, CLOSE, tolerance=0.03)
        yield from hand.reach(lambda: up, CLOSE, tolerance=0.03, turn=lambda: turned)
        down = up - [0, 0, FREE]
        yield from hand.reach(lambda: down, CLOSE, tolerance=0.012, turn=lambda: turned)
        yield from hand.hold(OPEN, steps=6)


def _x_axis(quaternion: np.ndarray) -> np.ndarray:
    """The horizontal part, of length 1, of the x axis [3] of a body with quaternion wxyz [4]."""
    axis = matrix_from_quaternion(quaternion)[:, 0] * [1, 1, 0]
    return axis / np.linalg.norm(axis)
