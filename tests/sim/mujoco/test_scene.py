"""Scenes: the slim model moves like robosuite's, and the visual model shows it."""

import itertools
import subprocess
import sys

import mujoco
import numpy as np
import pytest

from jaxcam.rays.rotations import matrix_from_quaternion
from jaxcam.sim.mujoco.mjcf import TABLE_SIZE, assemble
from jaxcam.sim.mujoco.scene import FIXTURES, SHEET_HALF_SIZE, build_scene
from jaxcam.sim.mujoco.table import TABLE_TOP


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


def test_what_robosuite_warns_of_ends_nothing_where_warnings_are_errors(tmp_path):
    """As it is compiled, which happens at its first import where nothing has been kept of it."""
    code = "import jaxcam.sim.mujoco.mjcf as m; m._robosuite_models()"
    flags = ["-X", f"pycache_prefix={tmp_path}", "-W", "error:invalid escape sequence"]
    subprocess.run([sys.executable, *flags, "-c", code], check=True)


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
