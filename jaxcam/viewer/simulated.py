"""Demonstrations and rollouts of our tasks as exhibits: bodies, cameras, pictures, grip."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxcam.data.demos import Demos
from jaxcam.data.splits import SPLITS
from jaxcam.errors import SimError
from jaxcam.rays import Camera, invert, sample_poses
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.rays.rotations import matrix_from_quaternion
from jaxcam.sim import make_painter
from jaxcam.sim.controllers import CONTROL_HZ
from jaxcam.sim.mujoco.scene import Scene
from jaxcam.sim.task import Task
from jaxcam.sim.types import Start, View
from jaxcam.sim.world import World
from jaxcam.viewer.bodies import bodies_of
from jaxcam.viewer.exhibit import GREEN, RED, Body, Exhibit, Viewpoint, Way

SIDE = 160
"""Pixels of a drawn picture's side."""
DRAWN = 240
"""Pictures that are drawn of an episode at most, evenly spread over its cameras."""
BOX = 0.04
"""Side (m) of what stands for objects whose shape is not known."""
_BOX_FACES = np.array([
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
])  # fmt: skip
TEST_CAMERAS = 50
"""Cameras of the evaluation that are shown beside those of a dataset."""


@dataclass(frozen=True)
class Course:
    """What happened in an episode of a task.

    Attributes:
        task: The task.
        world: Where.
        start: Of the episode.
        qpos: Joint positions [T, nq].
        world_from_camera: Who watches [V, 4, 4].
        test: Whether these are cameras of the test.
    """

    task: Task
    world: World
    start: Start
    qpos: np.ndarray
    world_from_camera: np.ndarray
    test: bool

    @property
    def base_from_world(self) -> np.ndarray:
        """Of the robot [4, 4]."""
        return np.asarray(invert(self.world.world_from_base))

    def bodies(self) -> tuple[tuple[Body, ...], str]:
        """What is seen of the world, and a note on what is not."""
        if isinstance(self.world, Scene):
            return bodies_of(self.world, self.task.varied, self.qpos, self.start), ""
        objects = [
            (name, self.qpos[:, at : at + 7])
            for name in getattr(self.world, "objects", ())
            for at in [self.world.qpos_of(name)]
        ]
        objects += zip(self.task.markers, self.start.fixtures[2:, None], strict=True)
        return tuple(self._box(name, places) for name, places in objects), (
            "SAPIEN lends no meshes: the robot is not shown, and objects are boxes of "
            f"{100 * BOX:g} cm where they are."
        )

    def viewpoints(self) -> tuple[tuple[Viewpoint, ...], str]:
        """The cameras with pictures that are drawn, and a note on what could not be."""
        count = len(self.world_from_camera)
        stride = -(-len(self.qpos) * count // DRAWN)
        steps = list(range(0, len(self.qpos), stride))
        K = intrinsics(self.task.fovy_deg, SIDE)
        try:
            self.task.require()
            painter = make_painter(self.world, SIDE, SIDE, varied=self.task.varied)
            pictures = [
                list(painter.rgb(self._view(pose, K, steps))) for pose in self.world_from_camera
            ]
            note = "" if stride == 1 else f"Pictures are drawn at every {stride}th step."
        except SimError as error:
            pictures, steps, note = [[]] * count, [], f"No pictures are drawn: {error}"
        group, colour = ("test", RED) if self.test else ("training", GREEN)
        poses = self.base_from_world @ self.world_from_camera
        return tuple(
            Viewpoint(
                f"{group} camera {i}", group, colour, Camera(K, pose, SIDE, SIDE), seen_at, steps
            )
            for i, (pose, seen_at) in enumerate(zip(poses, pictures, strict=True))
        ), note

    def _box(self, name: str, places: np.ndarray) -> Body:
        """What stands for an object whose places (xyz, wxyz) in the world [T, 7] are known."""
        poses = np.tile(np.eye(4), (len(places), 1, 1))
        poses[:, :3, :3], poses[:, :3, 3] = matrix_from_quaternion(places[:, 3:]), places[:, :3]
        corners = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(-1, 3)
        poses = self.base_from_world @ poses
        return Body(
            name,
            (BOX * (corners - 0.5)).astype(np.float32),
            _BOX_FACES,
            (205, 160, 60),
            poses if len(poses) > 1 else poses[0],
        )

    def _view(self, world_from_camera: np.ndarray, K: np.ndarray, steps: Sequence[int]) -> View:
        several = (len(steps), 1, 1)
        return View(
            qpos=self.qpos[list(steps)],
            geom_size=np.tile(self.start.geom_size, several),
            fixtures=np.tile(self.start.fixtures, several),
            K=np.tile(K, several),
            world_from_camera=np.tile(world_from_camera, several),
        )


def bystanders(
    course: Course, world_from_camera: np.ndarray, group: str, colour: tuple[int, int, int]
) -> tuple[Viewpoint, ...]:
    """Cameras without pictures.

    Args:
        course: In whose base frame they are shown.
        world_from_camera: Poses [N, 4, 4].
        group: What they are for.
        colour: What they are drawn in.
    """
    K = intrinsics(course.task.fovy_deg, SIDE)
    poses = course.base_from_world @ np.asarray(world_from_camera, float)
    return tuple(
        Viewpoint(f"{group} {i}", group, colour, Camera(K, pose, SIDE, SIDE), beside=True)
        for i, pose in enumerate(poses)
    )


def demonstration(demos: Demos, number: int) -> Exhibit:
    """One demonstration, with all cameras of its dataset.

    Args:
        demos: The dataset.
        number: Of the demonstration, in the file's order: those for training first.
    """
    demo, poses = demos.episodes[number], demos.header.world_from_camera
    is_valid = number >= len(demos.train)
    course = Course(demos.task, demos.world, demo.start(), demo.qpos, poses[demo.cameras], is_valid)
    bodies, no_bodies = course.bodies()
    shown, few = course.viewpoints()
    test = sample_poses(course.task.cameras, TEST_CAMERAS, SPLITS["test"].cameras)
    others = training_cameras(demos)
    others = np.setdiff1d(others, demo.cameras)
    kind = "validation" if is_valid else "training"
    return Exhibit(
        title=f"{demos.header.task}, {demos.header.scene}",
        subtitle=f"{demos.path.name}: demonstration {number} of {len(demos.episodes)}, for {kind}",
        rate=CONTROL_HZ,
        bodies=bodies,
        viewpoints=(
            *shown,
            *bystanders(course, poses[others], "training", GREEN),
            *bystanders(course, test, "test", RED),
        ),
        ways=(grip_way(course, demo.eef_pos),),
        notes=tuple(note for note in (no_bodies, few) if note),
    )


def training_cameras(demos: Demos) -> np.ndarray:
    """Numbers of the cameras that see training demonstrations."""
    return np.unique(np.concatenate([demo.cameras for demo in demos.train]))


def grip_way(course: Course, points: np.ndarray, name: str = "grip") -> Way:
    """The way of the grip.

    Args:
        course: In whose base frame it is shown.
        points: Where it was in the world (m) [T, 3].
        name: What it is called.
    """
    base_from_world = course.base_from_world
    return Way(name, (240, 196, 25), points @ base_from_world[:3, :3].T + base_from_world[:3, 3])
