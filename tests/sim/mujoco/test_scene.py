"""The slim physics model is the full one as far as motion goes; starts are what the paper says."""

import itertools

import mujoco
import numpy as np
import pytest

from jaxcam.errors import ConfigError
from jaxcam.rays.rotations import matrix_from_quaternion
from jaxcam.sim import make_task
from jaxcam.sim.mujoco.mjcf import TABLE_SIZE, assemble
from jaxcam.sim.mujoco.native import NativeEngine
from jaxcam.sim.mujoco.scene import FIXTURES, SHEET_HALF_SIZE, build_scene
from jaxcam.sim.mujoco.table import TABLE_TOP
from jaxcam.sim.task import ROOM_SHIFT, START_JOINT_NOISE, TABLE_SHIFT, starts
from jaxcam.sim.tasks.lift import HALF_SIZE, LIFTED, PLACEMENT


@pytest.fixture(scope="module")
def full_and_scene(lift):
    """robosuite's whole model, and the scene that was made of it."""
    full = mujoco.MjModel.from_xml_string(assemble(lift.objects(), TABLE_TOP).xml)
    return full, build_scene(lift.objects(), "fixed")


def names(model, kind, count):
    return [mujoco.mj_id2name(model, kind, i) for i in range(count)]


def test_slim_model_keeps_every_mass_and_inertia(full_and_scene):
    full, scene = full_and_scene
    slim = scene.physics
    assert slim.ngeom < full.ngeom / 3
    bodies = names(slim, mujoco.mjtObj.mjOBJ_BODY, slim.nbody)
    assert {"cube_main", "robot0_link7", "gripper0_right_rightfinger"} <= set(bodies)
    for name in bodies[1:]:
        a, b = slim.body(name), full.body(name)
        for field in ("mass", "inertia", "ipos", "iquat", "pos", "quat"):
            np.testing.assert_allclose(
                getattr(a, field), getattr(b, field), atol=1e-9, err_msg=f"{name} {field}"
            )


def test_the_palms_box_is_within_15_mm_of_the_hand(full_and_scene):
    """The bound of docs/engines.md. Convex bodies are as far apart as their extents differ."""
    full, scene = full_and_scene
    name = "gripper0_right_hand_collision"
    hand, box = full.geom(name), scene.physics.geom(name)
    mesh = int(hand.dataid[0])
    first, count = int(full.mesh_vertadr[mesh]), int(full.mesh_vertnum[mesh])
    corners = np.array(list(itertools.product((-1, 1), repeat=3))) * box.size
    parts = ((hand, full.mesh_vert[first : first + count]), (box, corners))
    outlines = [x @ matrix_from_quaternion(part.quat).T + part.pos for part, x in parts]
    ways = np.random.default_rng(0).normal(size=(20000, 3))
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    theirs, ours = ((outline @ ways.T).max(0) for outline in outlines)
    assert 0.014 < (ours - theirs).max() < 0.015
    assert -0.011 < (ours - theirs).min() < -0.010


def test_slim_model_moves_like_the_full_one(full_and_scene):
    full, scene = full_and_scene
    slim = scene.physics
    rng = np.random.default_rng(0)
    for model in (full, slim):
        assert (model.nq, model.nv, model.nu) == (16, 15, 9)
    np.testing.assert_array_equal(slim.actuator_ctrlrange, full.actuator_ctrlrange)
    np.testing.assert_array_equal(slim.actuator_gainprm, full.actuator_gainprm)
    np.testing.assert_array_equal(slim.actuator_biasprm, full.actuator_biasprm)
    assert slim.opt.timestep == full.opt.timestep
    qpos, qvel = slim.qpos0.copy(), rng.normal(size=slim.nv)
    qpos[scene.arm] = scene.home + 0.3 * rng.normal(size=7)
    dynamics = []
    for model in (full, slim):
        data = mujoco.MjData(model)
        data.qpos, data.qvel = qpos, qvel
        mujoco.mj_forward(model, data)
        mass = np.empty((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        dynamics.append((mass, data.qfrc_bias.copy(), data.qfrc_passive.copy()))
    for a, b in zip(*dynamics, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


def test_one_qpos_serves_both_models(scenes):
    for scene in scenes.values():
        joints = [
            names(model, mujoco.mjtObj.mjOBJ_JOINT, model.njnt)
            for model in (scene.physics, scene.visual)
        ]
        assert joints[0] == joints[1]
        np.testing.assert_array_equal(scene.physics.jnt_qposadr, scene.visual.jnt_qposadr)
        qpos = scene.physics.qpos0 + 0.05
        places = []
        for model in (scene.physics, scene.visual):
            data = mujoco.MjData(model)
            data.qpos = qpos
            mujoco.mj_kinematics(model, data)
            places.append([data.body(b).xpos for b in ("cube_main", "gripper0_right_leftfinger")])
        np.testing.assert_allclose(*places, atol=1e-12)


def test_many_worlds_fit_in_memory(scenes):
    for scene in scenes.values():
        assert mujoco.MjData(scene.physics).narena <= 2**24


def test_table_and_room_are_moved_from_arrays(scenes):
    for scene in scenes.values():
        model = scene.visual
        assert model.nmocap == len(FIXTURES)
        for mocap, name in zip(scene.fixtures, FIXTURES, strict=True):
            assert model.body(name).mocapid[0] == mocap
        assert model.ncam == 1
        # Nothing that is seen stands still in the world: all moves with robot, objects or fixtures.
        assert not any(model.geom_bodyid == 0)


def test_only_the_fixed_scene_shows_walls_and_a_table_with_edges(scenes):
    def geoms(name):
        model = scenes[name].visual
        return names(model, mujoco.mjtObj.mjOBJ_GEOM, model.ngeom)

    def hidden(n):
        return "wall" in n or "table_leg" in n

    assert any(hidden(n) for n in geoms("fixed"))
    assert not any(hidden(n) for n in geoms("randomized"))
    tops = {name: s.visual.geom("table_visual").size[:2] for name, s in scenes.items()}
    np.testing.assert_allclose(tops["fixed"], np.array(TABLE_SIZE[:2]) / 2)
    np.testing.assert_allclose(tops["randomized"], SHEET_HALF_SIZE)


def test_the_same_seed_gives_the_same_start_in_both_scenes(lift, scenes):
    fixed, randomized = (starts(lift, scenes[n], range(20)) for n in ("fixed", "randomized"))
    np.testing.assert_array_equal(fixed.qpos, randomized.qpos)
    np.testing.assert_array_equal(fixed.geom_size, randomized.geom_size)
    assert (fixed.fixtures == fixed.fixtures[0]).all()
    assert len(np.unique(randomized.fixtures[:, :, 0])) == 40
    again = lift.start(scenes["randomized"], 13)
    np.testing.assert_array_equal(again.qpos, randomized.qpos[13])
    np.testing.assert_array_equal(again.fixtures, randomized.fixtures[13])
    assert (np.ptp(randomized.qpos, 0)[:7] > 0).all()


def test_starts_fill_their_ranges_and_stay_inside(lift, scene):
    start = starts(lift, scene, range(400))
    cube = scene.qpos_of("cube")
    place, half = start.qpos[:, cube : cube + 3], start.geom_size[:, 0]
    for values, low, high in (
        (place[:, :2], -PLACEMENT, PLACEMENT),
        (half, *HALF_SIZE),
        (start.fixtures[:, 0, :2], -TABLE_SHIFT, TABLE_SHIFT),
        (start.fixtures[:, 1, :2], -ROOM_SHIFT, ROOM_SHIFT),
    ):
        assert low <= values.min() < low + 0.05 * (high - low)
        assert high >= values.max() > high - 0.05 * (high - low)
    np.testing.assert_allclose(place[:, 2], TABLE_TOP + half[:, 2] + 0.01)
    yaw = 2 * np.arctan2(start.qpos[:, cube + 6], start.qpos[:, cube + 3])
    assert np.ptp(yaw) > 1.9 * np.pi
    noise = start.qpos[:, scene.arm] - scene.home
    assert abs(noise.std() / START_JOINT_NOISE - 1) < 0.05
    top = start.fixtures[:, 0, 2] + scene.visual.geom("table_visual").size[2]
    np.testing.assert_allclose(top, TABLE_TOP)
    np.testing.assert_allclose(np.linalg.norm(start.fixtures[..., 3:], axis=-1), 1)


def test_lifted_is_four_centimetres_above_the_table(lift, scene):
    start = starts(lift, scene, range(3))
    state = NativeEngine(scene, varied=lift.varied).reset(start)
    state.qpos[:, scene.qpos_of("cube") + 2] = TABLE_TOP + LIFTED + np.array([-1e-6, 1e-6, 0.1])
    assert LIFTED == 0.04
    assert lift.success(scene, state, start).tolist() == [False, True, True]


def test_proprio_is_in_the_base_frame(lift, scene):
    qpos = lift.start(scene, 0).qpos
    qpos[scene.fingers] = 0.01, -0.02
    felt = scene.proprio(qpos, scene.world_from_base[:3, 3] + [0.1, 0.2, 0.3])
    assert felt.dtype == np.float32
    np.testing.assert_allclose(felt, [*qpos[scene.arm], 0.1, 0.2, 0.3, 0.03], rtol=1e-6)


def test_unknown_task_names_the_closest():
    with pytest.raises(ConfigError, match="Unknown task 'lfit', did you mean 'lift'"):
        make_task("lfit")
