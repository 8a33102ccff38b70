"""What is true of each task on robosuite's table."""

import mujoco
import numpy as np
import pytest

from jaxcam.rays import invert, sample_poses
from jaxcam.sim import make_task
from jaxcam.sim.mujoco.native import NativeEngine
from jaxcam.sim.mujoco.scene import FIXTURES
from jaxcam.sim.task import starts
from jaxcam.sim.tasks.pick_place_can import PickPlaceCan
from jaxcam.sim.types import Command

NEW = ("pick_place_can", "square")
OBJECTS = {"lift": ["cube"], "pick_place_can": ["can"], "square": ["nut", "peg"]}


@pytest.fixture(scope="module", params=NEW)
def world(request):
    """A task and its randomised scene."""
    task = make_task(request.param)
    return task, task.scene("randomized")


def place(scene, start, name):
    at = scene.qpos_of(name)
    return start.qpos[..., at : at + 3]


def still(engine, state, steps=40):
    """The world after a while, the hand staying where it is."""
    grip = np.concatenate([state.grip_position, np.tile([np.pi, 0, 0], (len(state.qpos), 1))], -1)
    for _ in range(steps):
        state = engine.step(state, Command(grip, -np.ones(len(grip))))
    return state


def test_what_the_paper_says_of_the_tasks(world):
    task, _ = world
    assert (task.horizon, task.views, task.stair) == (600, 2, (4, 2))


@pytest.mark.parametrize("name", NEW)
def test_scenes_share_the_draws_of_objects_and_target(name):
    task = make_task(name)
    fixed, randomized = (starts(task, task.scene(n), range(5)) for n in ("fixed", "randomized"))
    np.testing.assert_array_equal(fixed.qpos, randomized.qpos)
    np.testing.assert_array_equal(fixed.fixtures[:, 2:], randomized.fixtures[:, 2:])
    assert randomized.geom_size.shape == (5, 0, 3)


def test_nothing_moves_when_left_alone(world):
    task, scene = world
    start = starts(task, scene, range(4))
    engine = NativeEngine(scene)
    before = still(engine, engine.reset(start), steps=20)  # fallen the first centimetre
    after = still(engine, before)
    for name in OBJECTS[task.name]:
        at = scene.qpos_of(name)
        assert abs(after.qpos[:, at : at + 7] - before.qpos[:, at : at + 7]).max() < 2e-4
        upright = after.qpos[:, at + 4 : at + 6]
        assert abs(upright).max() < 5e-3
    assert not task.success(scene, after, start).any()


ABOVE = (0, 0, 0.2)


def test_the_target_is_seen_where_fixtures_say_and_never_touched():
    task = PickPlaceCan()
    for name in ("fixed", "randomized"):
        scene = task.scene(name)
        assert scene.visual.nmocap == len(FIXTURES) + 1
        geoms = [scene.physics.geom(i).name for i in range(scene.physics.ngeom)]
        assert not any("target" in name for name in geoms)
        assert scene.physics.nbody == scene.visual.nbody - 2  # target and room are only seen
        data = mujoco.MjData(scene.visual)
        fixtures = task.start(scene, 3).fixtures
        data.mocap_pos[scene.fixtures] = fixtures[:, :3]
        data.mocap_quat[scene.fixtures] = fixtures[:, 3:]
        mujoco.mj_kinematics(scene.visual, data)
        np.testing.assert_allclose(data.body("target_main").xpos, fixtures[2, :3])
        ghost = scene.visual.geom("target_g0")
        assert (ghost.contype[0], ghost.conaffinity[0]) == (0, 0)


def test_cameras_see_the_objects(world):
    """From nearly all camera poses the middles of all objects are in the picture."""
    task, scene = world
    start = starts(task, scene, range(200))
    cameras = sample_poses(task.cameras, 200, 23)
    half = np.tan(np.deg2rad(task.fovy_deg) / 2)
    points = [place(scene, start, name) for name in OBJECTS[task.name]]
    points = np.stack([*points, *np.moveaxis(start.fixtures[:, 2:, :3], 1, 0)], 1)
    camera_from_world = np.asarray(invert(cameras))
    local = points @ camera_from_world[:, :3, :3].swapaxes(1, 2) + camera_from_world[:, None, :3, 3]
    inside = (abs(local[..., :2]) < half * local[..., 2:]).all(-1)
    assert inside.mean() > 0.85
    two = inside.reshape(100, 2, -1)  # one of two cameras sees it
    assert two.any(1).mean() > 0.95
