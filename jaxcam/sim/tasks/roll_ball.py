"""Roll Ball: push a ball so that it rolls onto a round target out of reach."""

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from jaxcam.rays import POSE_RANGES, PoseRanges
from jaxcam.rays.rotations import Array
from jaxcam.sim.experts import CLOSE, Hand, pushing_grip
from jaxcam.sim.maniskill.task import ManiSkillTask, goal_pose, is_over_goal
from jaxcam.sim.types import Aim, ExpertSight, Start, State
from jaxcam.sim.world import World

BALL = 0.035
"""Radius of the ball (m), ManiSkill's."""
ACROSS = (-0.4, 0.2)
"""Range (m) of the x of ball and target."""
FROM, TO = (0.5, 0.7), (-0.3, -0.1)
"""Ranges (m) of the y of ball and target (authors' RollBallRand; the robot is at y = 1)."""
BEHIND, HOVER, DOWN = 0.07, 0.14, 0.03
"""Distance (m) from the ball's middle to the grip before pushing, and heights (m) of the grip on
the way there and while it pushes."""
AHEAD, THROUGH = 0.03, 0.2
"""How far (m) before the ball the pushing hand aims, and how far beyond its start it goes."""
NEAR = 0.08
"""Distance (m) between ball and target at which the expert is content."""
PATIENCE = 80
"""Control steps for which it watches the ball roll."""


class RollBall(ManiSkillTask):
    """Roll Ball (paper, section IV-A; ManiSkill's `RollBall`, the authors' `RollBallRand`)."""

    name: ClassVar[str] = "roll_ball"
    prompt: ClassVar[str] = "Roll the ball to the target"
    env: ClassVar[str] = "JaxcamRollBall-v1"
    horizon: ClassVar[int] = 150
    views: ClassVar[int] = 2
    stair: ClassVar[tuple[int, int]] = (4, 2)
    cameras: ClassVar[PoseRanges] = POSE_RANGES["maniskill_roll_ball"]
    fovy_deg: ClassVar[float] = 90.0
    markers: ClassVar[tuple[str, ...]] = ("goal_region",)
    base: ClassVar[tuple[float, float, float]] = (-0.1, 1.0, -np.pi / 2)

    def objects(self) -> list[str]:
        """The ball, by ManiSkill's name."""
        return ["ball"]

    def place(self, scene: World, rng: np.random.Generator, start: Start) -> None:
        """The ball before the robot, the target at the table's other half."""
        ball = scene.qpos_of("ball")
        start.qpos[ball : ball + 3] = rng.uniform(*ACROSS), rng.uniform(*FROM), BALL
        start.fixtures[2] = goal_pose(np.array([rng.uniform(*ACROSS), rng.uniform(*TO)]))

    def success(self, scene: World, state: State, start: Start) -> Array:
        """The ball's middle is over the target, rolling or not."""
        ball = scene.qpos_of("ball")
        return is_over_goal(state.qpos[..., ball : ball + 2], start)

    def expert(self, scene: World, sight: ExpertSight) -> Iterator[Aim]:
        """Behind the ball, down, push towards the target, and watch; fingers closed."""
        at, base = scene.qpos_of("ball"), scene.world_from_base[:3, 3]
        target = sight.start.fixtures[2, :2]
        hand = Hand(sight)
        first = sight.qpos[at : at + 2].copy()

        def to_target() -> np.ndarray:
            return target - sight.qpos[at : at + 2]

        def along() -> np.ndarray:
            return to_target() / np.linalg.norm(to_target())

        def turned() -> np.ndarray:
            return pushing_grip(base, sight.grip_position, along(), sight.grip_rotation)

        def behind(height: float) -> np.ndarray:
            return np.array([*(sight.qpos[at : at + 2] - BEHIND * along()), height])

        def ahead() -> np.ndarray:
            point = sight.qpos[at : at + 2] + AHEAD * along()
            over = max(0.0, float((point - first) @ along()) - THROUGH)
            return np.array([*(point - over * along()), DOWN])

        yield from hand.reach(lambda: behind(HOVER), CLOSE, tolerance=0.02, turn=turned, stray=0.06)
        yield from hand.reach(lambda: behind(DOWN), CLOSE, tolerance=0.01, turn=turned)
        yield from hand.reach(ahead, CLOSE, tolerance=0.04, turn=turned)
        for _ in range(PATIENCE):
            if np.linalg.norm(to_target()) < NEAR:
                return
            yield from hand.hold(CLOSE, steps=1)
