"""Starts, success, markers and physics of the tasks, each against what the task promises."""

from xml.etree import ElementTree as ET

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from jaxcam.rays import invert, sample_poses
from jaxcam.sim import make_task
from jaxcam.sim.mujoco.mjcf import robosuite_object
from jaxcam.sim.mujoco.native import NativeEngine
from jaxcam.sim.mujoco.objects import prism
from jaxcam.sim.mujoco.scene import FIXTURES
from jaxcam.sim.mujoco.table import TABLE_TOP
from jaxcam.sim.task import starts
from jaxcam.sim.tasks import pick_place_can as can
from jaxcam.sim.tasks import square
from jaxcam.sim.tasks.pick_place_can import PickPlaceCan
from jaxcam.sim.tasks.square import Square
from jaxcam.sim.types import Command, Start, State

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


def fills(values, half):
    assert abs(values).max() <= half
    assert values.min() < -0.95 * half
    assert values.max() > 0.95 * half


def still(engine, state, steps=40):
    """The world after a while, the hand staying where it is."""
    grip = np.concatenate([state.grip_position, np.tile([np.pi, 0, 0], (len(state.qpos), 1))], -1)
    for _ in range(steps):
        state = engine.step(state, Command(grip, -np.ones(len(grip))))
    return state


def test_what_the_paper_says_of_the_tasks(world):
    task, _ = world
    assert (task.horizon, task.views, task.stair) == (600, 2, (4, 2))


def test_can_and_target_fill_their_ranges_and_stay_apart():
    task = PickPlaceCan()
    scene = task.scene("randomized")
    start = starts(task, scene, range(400))
    both = np.stack([place(scene, start, "can"), start.fixtures[:, 2, :3]])
    fills(both[..., :2], 0.2)
    apart = np.linalg.norm((both[0] - both[1])[:, :2], axis=-1)
    assert 0.15 <= apart.min() < 0.17
    np.testing.assert_allclose(both[0, :, 2], TABLE_TOP + 0.05)
    np.testing.assert_allclose(both[1, :, 2], TABLE_TOP + 0.04)


def test_nut_and_peg_fill_their_ranges_and_stay_apart():
    task = Square()
    scene = task.scene("randomized")
    start = starts(task, scene, range(400))
    nut, peg = place(scene, start, "nut"), place(scene, start, "peg")
    fills(np.stack([nut, peg])[..., :2], 0.18)
    apart = np.linalg.norm((nut - peg)[:, :2], axis=-1)
    assert square.APART <= apart.min() < square.APART + 0.02
    np.testing.assert_allclose(nut[:, 2], TABLE_TOP + 0.02)
    np.testing.assert_allclose(peg[:, 2], TABLE_TOP + 0.005)
    tip = np.hypot(0.054 + 0.02525, 0.015875)  # farthest corner of robosuite's nut
    assert tip + np.hypot(*square.BASE_HALF_SIZE[:2]) < square.APART


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


def test_the_can_stands_as_high_as_robosuite_says():
    task = PickPlaceCan()
    scene = task.scene("fixed")
    engine = NativeEngine(scene)
    state = still(engine, engine.reset(starts(task, scene, range(2))))
    np.testing.assert_allclose(place(scene, state, "can")[:, 2], TABLE_TOP + 0.04, atol=1e-3)


def can_state(aside, height, count=1):
    """A can at a place relative to its target."""
    task = PickPlaceCan()
    scene = task.scene("fixed")
    start = starts(task, scene, range(count))
    state = NativeEngine(scene).reset(start)
    at = scene.qpos_of("can")
    state.qpos[:, at : at + 2] = start.fixtures[:, 2, :2] + aside
    state.qpos[:, at + 2] = TABLE_TOP + height
    return task, scene, state, start


@pytest.mark.parametrize(
    ("aside", "height", "done"),
    [
        ([0.0, 0.0], 0.04, True),
        ([0.03, -0.0399], 0.04, True),
        ([0.03, 0.0401], 0.04, False),
        ([-0.051, 0.0], 0.04, False),
        ([0.0, 0.0], 0.099, True),
        ([0.0, 0.0], 0.101, False),
        ([0.0, 0.0], -0.001, False),
    ],
)
def test_the_can_is_placed_near_its_target_and_low(aside, height, done):
    task, scene, state, start = can_state(aside, height)
    assert task.success(scene, state, start).tolist() == [done]


def square_state(nut, grip):
    """A nut relative to the peg's foot, its handle along y, and the grip relative to its middle."""
    task = Square()
    scene = task.scene("fixed")
    start = starts(task, scene, [0])
    state = NativeEngine(scene).reset(start)
    at = scene.qpos_of("nut")
    state.qpos[:, at : at + 2] = place(scene, state, "peg")[:, :2] + nut[:2]
    state.qpos[:, at + 2] = TABLE_TOP + nut[2]
    state.qpos[:, at + 3 : at + 7] = [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]
    state.grip_position[:] = state.qpos[:, at : at + 3] + grip
    return task, scene, state, start


ABOVE = (0, 0, 0.2)


@pytest.mark.parametrize(
    ("nut", "grip", "done"),
    [
        ((0, 0, 0.02), ABOVE, True),
        ((0.0299, -0.0299, 0.02), ABOVE, True),
        ((0.0301, 0, 0.02), ABOVE, False),
        ((0, -0.0301, 0.02), ABOVE, False),
        ((0, 0, 0.0999), ABOVE, True),
        ((0, 0, 0.1001), ABOVE, False),
        ((0, 0, 0.02), (0, 0, 0.0425), True),
        ((0, 0, 0.02), (0, 0, 0.0422), False),
        ((0, 0, 0.02), (0, 0.054, 0), False),  # holds the handle
        ((0, 0, 0.02), (0, 0.054, 0.0425), True),
        ((0, 0, 0.02), (0, -0.054, 0), True),
    ],
)
def test_the_nut_is_around_the_peg_low_and_let_go(nut, grip, done):
    task, scene, state, start = square_state(nut, grip)
    assert task.success(scene, state, start).tolist() == [done]


def test_success_runs_on_device(world):
    task, scene = world
    start = starts(task, scene, range(3))
    state = NativeEngine(scene).reset(start)
    if task.name == "square":
        _, _, state, start = square_state((0, 0, 0.02), ABOVE)
    else:
        _, _, state, start = can_state([0.01, 0], 0.04, 3)
    wanted = task.success(scene, state, start)
    assert wanted.all()
    on_device = jax.jit(lambda state, start: task.success(scene, state, start))
    success = on_device(State(*map(jnp.asarray, state)), Start(*map(jnp.asarray, start)))
    np.testing.assert_array_equal(success, wanted)


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


def test_physics_has_robosuites_masses():
    """The can's and the nut's are those of robosuite's models, the peg's that of the cylinder."""
    for name, task in (("can_main", PickPlaceCan()), ("nut_main", Square())):
        model = mujoco.MjModel.from_xml_string(alone(robosuite_object(task.objects()[0])))
        physics = task.scene("fixed").physics
        body = physics.body(name)
        np.testing.assert_allclose(body.mass[0], model.body(name).mass[0], rtol=1e-5)
        np.testing.assert_allclose(body.inertia, model.body(name).inertia, rtol=1e-5)
    volume = np.pi * square.PEG_RADIUS**2 * 2 * square.PEG_HALF_LENGTH
    volume += 8 * np.prod(square.BASE_HALF_SIZE)
    peg = Square().scene("fixed").physics.body("peg_root")
    np.testing.assert_allclose(peg.mass[0], square.DENSITY * volume, rtol=1e-5)


def alone(thing):
    """The MJCF of one robosuite object by itself."""
    root = ET.Element("mujoco")
    root.append(thing.asset)
    body = ET.SubElement(root, "worldbody")
    body.append(thing.get_obj())
    return ET.tostring(root, encoding="unicode")


def test_hulls_are_small_and_fit():
    model = PickPlaceCan().scene("fixed").physics
    geom = model.geom("can_g0")
    assert geom.type[0] == mujoco.mjtGeom.mjGEOM_MESH
    assert model.mesh_vertnum[geom.dataid[0]] == 16
    corners = prism(can.RADIUS, can.HALF_HEIGHT, 8)
    outer = np.linalg.norm(corners[:, :2], axis=-1)
    np.testing.assert_allclose((outer + outer * np.cos(np.pi / 8)) / 2, can.RADIUS)
    np.testing.assert_allclose(abs(corners[:, 2]), can.HALF_HEIGHT)


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
