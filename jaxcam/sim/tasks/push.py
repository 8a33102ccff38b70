"""Push: slide a cube onto a round target."""

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from jaxcam.rays import POSE_RANGES, PoseRanges
from jaxcam.rays.rotations import Array
from jaxcam.sim.experts import CLOSE, Hand, pushing_grip
from jaxcam.sim.maniskill.task import ManiSkillTask, goal_pose, is_over_goal
from jaxcam.sim.types import Aim, ExpertSight, Start, State
from jaxcam.sim.world import World

HALF_SIZE = 0.02
"""Of the cube (m), ManiSkill's."""
ANCHOR, MIDDLE = 0.1, (-0.05, 0.0)
"""Half-range (m) and middle of the point that lies a third of the way from cube to target."""
TRAVEL = (0.2, 0.3)
"""Range (m) of the distance from cube to target, in any direction."""
LOW = 0.005
"""Height (m) over where it rests up to which the cube counts as on the table."""
BEHIND, TOUCH = 0.075, 0.03
"""Distances (m) from the cube's middle to the grip before pushing, and while it pushes."""
HOVER, DOWN = 0.10, 0.02
"""Heights (m) of the grip on the way there, and while it pushes."""
NEAR = 0.03
"""Distance (m) between cube and target at which the expert is content."""


class Push(ManiSkillTask):
    """Push (paper, section IV-A; ManiSkill's `PushCube`, the authors' `PushCubeRand`)."""

    name: ClassVar[str] = "push"
    prompt: ClassVar[str] = "Push the cube to the target"
    env: ClassVar[str] = "JaxcamPush-v1"
    horizon: ClassVar[int] = 150
    views: ClassVar[int] = 1
    stair: ClassVar[tuple[int, int]] = (3, 1)
    cameras: ClassVar[PoseRanges] = POSE_RANGES["maniskill_push"]
    fovy_deg: ClassVar[float] = float(np.rad2deg(1.0))
    markers: ClassVar[tuple[str, ...]] = ("goal_region",)

    def objects(self) -> list[str]:
        """The cube, by ManiSkill's name."""
        return ["cube"]

    def place(self, scene: World, rng: np.random.Generator, start: Start) -> None:
        """Cube and target on a segment about the middle of the table, the cube facing along it."""
        anchor = np.add(MIDDLE, rng.uniform(-ANCHOR, ANCHOR, 2))
        travel, yaw = rng.uniform(*TRAVEL), rng.uniform(-np.pi, np.pi)
        along = np.array([np.cos(yaw), np.sin(yaw)])
        cube = scene.qpos_of("cube")
        start.qpos[cube : cube + 3] = *(anchor - travel / 3 * along), HALF_SIZE
        start.qpos[cube + 3 : cube + 7] = [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
        start.fixtures[2] = goal_pose(anchor + travel * 2 / 3 * along)

    def success(self, scene: World, state: State, start: Start) -> Array:
        """The cube's middle is over the target, and the cube on the table."""
        cube = scene.qpos_of("cube")
        low = state.qpos[..., cube + 2] < HALF_SIZE + LOW
        return is_over_goal(state.qpos[..., cube : cube + 2], start) & low

    def expert(self, scene: World, sight: ExpertSight) -> Iterator[Aim]:
        """Behind the cube, down, and on until it is over the target's middle; fingers closed."""
        cube = slice(scene.qpos_of("cube"), scene.qpos_of("cube") + 2)
        target = sight.start.fixtures[2, :2]
        hand = Hand(sight)
        along = target - sight.qpos[cube]
        along = along / np.linalg.norm(along)
        base = scene.world_from_base[:3, 3]

        def turned() -> np.ndarray:
            return pushing_grip(base, sight.grip_position, along, sight.grip_rotation)

        def behind(height: float) -> np.ndarray:
            return np.array([*(sight.qpos[cube] - BEHIND * along), height])

        def onwards() -> np.ndarray:
            way = target - sight.qpos[cube]
            return np.array([*(target - TOUCH * way / max(np.linalg.norm(way), 1e-6)), DOWN])

        yield from hand.reach(lambda: behind(HOVER), CLOSE, tolerance=0.02, turn=turned, stray=0.06)
        yield from hand.reach(lambda: behind(DOWN), CLOSE, tolerance=0.01, turn=turned)
        yield from hand.reach(onwards, CLOSE, tolerance=0.02, turn=turned)
