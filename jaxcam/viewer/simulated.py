"""Demonstrations and rollouts of our tasks as exhibits: bodies, cameras, pictures, grip."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import numpy as np

from jaxcam.config.conditions import Conditions
from jaxcam.data.demos import Demos
from jaxcam.data.header import optics_ranges
from jaxcam.data.pairs import Pairs
from jaxcam.data.splits import SPLITS
from jaxcam.errors import SimError
from jaxcam.evaluation.conditions import ConditionedPairs
from jaxcam.rays import Camera, invert, sample_poses
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.rays.optics import at_size, sample_optics
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
        cameras: Who watches [V], in the world, with pictures of `SIDE`.
        test: Whether these are cameras of the test.
    """

    task: Task
    world: World
    start: Start
    qpos: np.ndarray
    cameras: Camera
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
        (count,) = self.cameras.batch
        stride = -(-len(self.qpos) * count // DRAWN)
        steps = list(range(0, len(self.qpos), stride))
        lenses = self.cameras.distortion is not None
        try:
            self.task.require()
            painter = make_painter(self.world, SIDE, varied=self.task.varied, lenses=lenses)
            pictures = [list(painter.rgb(self._view(c, steps))) for c in each(self.cameras)]
            note = "" if stride == 1 else f"Pictures are drawn at every {stride}th step."
        except SimError as error:
            pictures, steps, note = [[]] * count, [], f"No pictures are drawn: {error}"
        group, colour = ("test", RED) if self.test else ("training", GREEN)
        cameras = each(self.cameras.in_frame(self.base_from_world))
        return tuple(
            Viewpoint(f"{group} camera {i}", group, colour, camera, seen_at, steps)
            for i, (camera, seen_at) in enumerate(zip(cameras, pictures, strict=True))
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

    def _view(self, camera: Camera, steps: Sequence[int]) -> View:
        several = (len(steps), 1, 1)
        return View(
            qpos=self.qpos[list(steps)],
            geom_size=np.tile(self.start.geom_size, several),
            fixtures=np.tile(self.start.fixtures, several),
            K=np.tile(camera.K, several),
            world_from_camera=np.tile(camera.world_from_camera, several),
            lens=None if camera.distortion is None else np.tile(camera.distortion, several[:2]),
        )


def each(cameras: Camera) -> list[Camera]:
    """The cameras of a batch [N], one by one."""
    return [jax.tree.map(lambda part, i=i: part[i], cameras) for i in range(*cameras.batch)]


def bystanders(
    course: Course, cameras: Camera, group: str, colour: tuple[int, int, int]
) -> tuple[Viewpoint, ...]:
    """Cameras without pictures.

    Args:
        course: In whose base frame they are shown.
        cameras: Which [N], in the world.
        group: What they are for.
        colour: What they are drawn in.
    """
    return tuple(
        Viewpoint(f"{group} {i}", group, colour, camera, beside=True)
        for i, camera in enumerate(each(cameras.in_frame(course.base_from_world)))
    )


def trainers(course: Course, demos: Demos, rows: np.ndarray) -> tuple[Viewpoint, ...]:
    """Cameras of a dataset, without pictures.

    Args:
        course: In whose base frame they are shown.
        demos: The dataset.
        rows: Numbers of the cameras.
    """
    return bystanders(course, demos.header.camera(rows, SIDE), "training", GREEN)


def demonstration(demos: Demos, number: int) -> Exhibit:
    """One demonstration, with all cameras of its dataset.

    Args:
        demos: The dataset.
        number: Of the demonstration, in the file's order: those for training first.
    """
    demo, header = demos.episodes[number], demos.header
    is_valid = number >= len(demos.train)
    watching = header.camera(demo.cameras, SIDE)
    course = Course(demos.task, demos.world, demo.start(), demo.qpos, watching, is_valid)
    bodies, no_bodies = course.bodies()
    shown, few = course.viewpoints()
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
            *trainers(course, demos, others),
            *bystanders(course, _test_cameras(demos), "test", RED),
        ),
        ways=(grip_way(course, demo.eef_pos),),
        notes=tuple(note for note in (no_bodies, few) if note),
    )


def _test_cameras(demos: Demos) -> Camera:
    """The first cameras of the evaluation, drawn from the ranges of the dataset's."""
    task, seed = demos.task, SPLITS["test"].cameras
    poses = sample_poses(task.cameras, TEST_CAMERAS, seed)
    ranges = optics_ranges(Conditions(**demos.header.ranges), task.fovy_deg)
    if ranges is None:
        K = np.broadcast_to(intrinsics(task.fovy_deg, SIDE), (TEST_CAMERAS, 3, 3))
        return Camera(K, poses, SIDE, SIDE)
    K, lens = sample_optics(ranges, TEST_CAMERAS, seed)
    return Camera(at_size(K, SIDE), poses, SIDE, SIDE, lens)


def seen_pairs(
    task: Task, world: World, conditions: Conditions, pairs: Pairs, split: str, numbers: list[int]
) -> Camera:
    """The cameras [B, V] that see pairs under conditions, in the world, with pictures of `SIDE`.

    Args:
        task: What is done.
        world: Where.
        conditions: Which.
        pairs: Which.
        split: `test` or `validation`.
        numbers: Of the pairs.
    """
    optics = ConditionedPairs(task, world, conditions).seen(pairs, split, numbers, (SIDE, SIDE))
    return Camera(optics.K, pairs.cameras, SIDE, SIDE, optics.lens)


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
