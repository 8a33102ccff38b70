"""MJX against the native engine, and what a batch of worlds on a device must keep apart."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from jax.tree_util import Partial
from mujoco import mjx
from mujoco.mjx import forward as warp_forward
from mujoco.mjx.third_party.mujoco_warp import OverflowType

from jaxcam.data.batches import demo_actions
from jaxcam.data.demos import starts_of
from jaxcam.errors import ConfigError, SimError
from jaxcam.rays import sample_poses
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.rays.rotations import array_namespace, matrix_from_rotvec, rotvec_from_matrix
from jaxcam.sim import engine_name, make_engine
from jaxcam.sim.actions import decode, measured
from jaxcam.sim.engine import OpenLoop
from jaxcam.sim.mujoco.mjx import MjxEngine
from jaxcam.sim.mujoco.mjx_room import LOST_FOR_GOOD, Room
from jaxcam.sim.mujoco.native import NativeEngine
from jaxcam.sim.rollout import Agent, Episodes, rollout
from jaxcam.sim.task import starts
from jaxcam.sim.tasks.lift import Lift
from jaxcam.sim.types import Command

WORLDS = 3
OPEN_LOOP = OpenLoop()
CONTROLLERS = ("osc_pose", "joint_position")


@pytest.fixture(scope="module")
def start(lift, scene):
    """Cubes of different sizes that touch the table, each in its own place."""
    begun = starts(lift, scene, range(WORLDS))
    cube = scene.qpos_of("cube")
    begun.qpos[:, cube : cube + 2] = [[0, 0], [0.02, -0.1], [-0.05, 0.1]]
    begun.qpos[:, cube + 2] -= 0.0101
    return begun


@pytest.fixture(scope="module")
def warp(lift, scene):
    return {c: MjxEngine(scene, c, lift.varied) for c in CONTROLLERS}


def wave(scene, state, controller, steps):
    """Targets [B, T, ...] around where the arm is, and a gripper that opens and closes."""
    angle = np.arange(steps)[None, :, None] / 8 + np.arange(WORLDS)[:, None, None]
    if controller == "osc_pose":
        rotvec = rotvec_from_matrix(state.grip_rotation)
        pose = np.concatenate([state.grip_position, rotvec], -1)[:, None]
        target = pose + 0.05 * np.sin(angle + np.arange(6)) * [1, 1, 1, 0.5, 0.5, 0.5]
    else:
        target = state.qpos[:, None, scene.arm] + 0.1 * np.sin(angle + np.arange(7))
    return Command(target, np.where(np.sin(angle[..., 0]) > 0, 1.0, -1.0))


def never(state, start):
    return state.qpos[:, 0] > 100


def follow(engine, start, commands, success=never, horizon=None, tick=lambda: None):
    """The way [T + 1, B, nq] and the progress at its end."""
    horizon = horizon or commands.target.shape[1]
    progress, way = engine.run(OPEN_LOOP, commands, start, success, horizon, tick=tick)
    return np.asarray(way), progress


def assert_as_native(engine, controller, lift, scene, start, steps):
    native = NativeEngine(scene, controller, lift.varied)
    commands = wave(scene, native.reset(start), controller, steps)
    there, there_progress = follow(native, start, commands)
    here, here_progress = follow(engine, start, commands)
    assert abs(there[-1] - there[0]).max() > 0.01  # the arm has moved, the cubes pressed the table
    np.testing.assert_allclose(here, there, atol=1e-4)
    for name in ("grip_position", "grip_rotation", "qvel", "closed"):
        a, b = getattr(here_progress.state, name), getattr(there_progress.state, name)
        np.testing.assert_allclose(a, b, atol=1e-3, err_msg=name)


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_free_motion_and_contacts_are_as_native(lift, scene, start, warp, controller):
    assert_as_native(warp[controller], controller, lift, scene, start, steps=3)  # 75 physics steps


@pytest.mark.slow
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_fifty_control_steps_are_as_native(lift, scene, start, warp, controller):
    assert_as_native(warp[controller], controller, lift, scene, start, steps=50)


def test_an_edge_meets_a_face_as_in_the_c_library(scene, warp):
    """Cubes gripped by two of their edges, turned, tilted a little: they must not pivot there."""
    model, engine, count = scene.physics, warp["osc_pose"], 8
    data, rng, cube = mujoco.MjData(model), np.random.default_rng(0), scene.qpos_of("cube")
    pads = [model.geom(f"gripper0_right_finger{i}_pad_collision").id for i in (1, 2)]
    qpos, want = np.tile(model.qpos0, (count, 1)), []
    for world, row in enumerate(qpos):
        row[scene.arm], row[scene.fingers] = scene.home, (0.0294, -0.0294)
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        turn = np.pi / 4 + rng.uniform(-0.1, 0.1)
        tilt = matrix_from_rotvec(np.array([0, 0, turn])) @ matrix_from_rotvec(
            rng.normal(0, 3e-3, 3)
        )
        row[cube : cube + 3] = data.geom_xpos[pads].mean(0)
        mujoco.mju_mat2Quat(
            row[cube + 3 : cube + 7], (data.geom_xmat[pads[0]].reshape(3, 3) @ tilt).ravel()
        )
        data.qpos[:] = row
        mujoco.mj_forward(model, data)
        want += [(world, *sorted(c.geom), c.dist) for c in data.contact if c.dist < -1e-5]
    physics, room = engine.physics, engine.room
    data = physics.scratch(count, room.contacts, room.rows).full
    forward = jax.vmap(lambda qpos: warp_forward(physics.model, data.replace(qpos=qpos)))
    outcome = jax.jit(forward)(jnp.asarray(qpos, jnp.float32))._impl
    rows = slice(int(np.max(outcome.nacon)))
    worlds, dist = (np.ravel(x)[rows] for x in (outcome.contact__worldid, outcome.contact__dist))
    geoms = np.sort(np.reshape(outcome.contact__geom, (-1, 2))[rows], -1)
    rows = dist < -1e-5
    got = sorted(zip(worlds[rows], *geoms[rows].T, dist[rows], strict=True))
    assert len(want) >= 4 * count  # two on each pad
    np.testing.assert_allclose(got, sorted(want), atol=2e-6)


def test_inactive_worlds_stay_and_a_diverging_one_is_lost_alone(scene, start, warp):
    engine = warp["osc_pose"]
    before = engine.reset(start)
    command = wave(scene, before, "osc_pose", 1)
    command = Command(command.target[:, 0], command.gripper[:, 0])
    healthy = engine.step(before, command)
    after = engine.step(before, command, np.array([True, False, True]))
    spoilt = engine.step(before._replace(qvel=before.qvel.at[1, 3].set(np.inf)), command)
    for old, new, alone, whole in zip(before, after, spoilt, healthy, strict=True):
        np.testing.assert_array_equal(new[1], old[1])
        for i in (0, 2):
            np.testing.assert_array_equal(new[i], whole[i])
            np.testing.assert_array_equal(alone[i], whole[i])
    assert abs(after.qpos[0] - before.qpos[0]).max() > 1e-4
    assert healthy.ok.all()
    assert spoilt.ok.tolist() == [True, False, True]
    assert np.isfinite(spoilt.qpos).all()
    again = engine.step(spoilt, command)
    np.testing.assert_array_equal(again.qpos[1], spoilt.qpos[1])
    assert engine.reset(start).ok.all()


def test_worlds_begin_anew_without_a_trace_in_the_others(scene, start, warp):
    engine, again = warp["osc_pose"], np.array([False, True, False])
    fresh = engine.reset(start)
    command = wave(scene, fresh, "osc_pose", 1)
    later = engine.step(fresh, Command(command.target[:, 0], command.gripper[:, 0]))
    for old, new, first in zip(later, engine.restart(later, start, again), fresh, strict=True):
        np.testing.assert_array_equal(new[~again], old[~again])
        np.testing.assert_array_equal(new[again], first[again])


def test_success_and_horizon_freeze_inside_the_program(lift, scene, start, warp):
    native = NativeEngine(scene, varied=lift.varied)
    commands = wave(scene, native.reset(start), "osc_pose", 4)
    way, _ = follow(native, start, commands)
    far = np.sort(abs(way[2, :, 0] - start.qpos[:, 0]))[1] - 1e-5  # two worlds are there by step 2

    def moved(state, start):
        return abs(state.qpos[:, 0] - start.qpos[:, 0]) > far

    engine, ticks = warp["osc_pose"], []
    way, progress = follow(engine, start, commands, moved, 3, lambda: ticks.append(0))
    way = way[1:]
    assert len(way) == len(ticks) == 3
    assert int(progress.success.sum()) >= 2
    for i, (done, step) in enumerate(zip(progress.success, progress.steps, strict=True)):
        now = abs(way[:, i, 0] - start.qpos[i, 0]) > far
        assert bool(done) == bool(now.any())
        assert step == (1 + int(np.argmax(now)) if done else 3)
        assert (way[step - 1 :, i] == way[step - 1, i]).all()


class ShortLift(Lift):
    horizon = 3


def by_sight(gain, obs, call, active):
    """Moves [B, 4, 7] that depend on all that a policy is shown, and on the turn."""
    colour = obs["image"].astype("float32").mean((1, 2, 3)) / 255  # [B, 3]
    where = obs["proprio"][:, 7:10] + obs["base_from_camera"][:, 0, :3, 3]
    move = gain * (colour - 0.3) + 0.002 * where + 0.005 * call
    xp = array_namespace(colour)
    pose = xp.concatenate([move, 0 * move, xp.ones_like(move[:, :1])], -1)
    return xp.stack([pose] * 4, 1)


def test_a_policy_in_the_loop_is_one_program(lift, scene, mjx_renderer, start, warp):
    poses = sample_poses(lift.cameras, WORLDS, 0)[:, None]
    K = np.tile(intrinsics(45, mjx_renderer.height), (WORLDS, 1, 1, 1))
    alive, done, ticks = np.array([True, True, False]), [], []
    for engine in (NativeEngine(scene, varied=lift.varied), warp["osc_pose"]):
        act = Partial(by_sight, np.float32(0.05))
        agent, episodes = Agent(act, "eef_delta", 2), Episodes(start, K, poses, alive)
        done.append(
            rollout(agent, ShortLift(), engine, mjx_renderer, episodes, lambda: ticks.append(0))
        )
    native, mjx = done
    assert native.qpos.shape == mjx.qpos.shape == (4, WORLDS, scene.physics.nq)
    assert len(ticks) == 6
    assert abs(native.qpos[-1] - native.qpos[0])[:2].max(1).min() > 0.01
    np.testing.assert_allclose(mjx.qpos, native.qpos, atol=1e-4)
    np.testing.assert_array_equal(mjx.qpos[:, 2], mjx.qpos[[0] * 4, 2])
    assert mjx.ok.all()
    assert native.ok.all()
    assert mjx.acted.tolist() == native.acted.tolist() == alive.tolist()
    assert mjx.steps.tolist() == native.steps.tolist()


def test_room_for_contacts_grows_until_none_is_lost(lift, scene, start, warp, caplog):
    narrow = MjxEngine(scene, "joint_position", lift.varied, room=Room(contacts=3))
    states = []
    for engine in (narrow, warp["joint_position"]):
        state = engine.reset(start)
        command = Command(np.asarray(state.qpos[:, scene.arm]), -np.ones(WORLDS))
        states.append(engine.step(state, command))
    assert "goes on with 6" in caplog.text
    np.testing.assert_allclose(states[0].qpos, states[1].qpos, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "room"),
    [("contacts", Room(1, most_contacts=1)), ("rows", Room(44, rows=1, most_rows=1))],
)
def test_lost_contacts_are_an_error_when_there_was_much_room(lift, scene, start, name, room):
    engine = MjxEngine(scene, "joint_position", lift.varied, room=room)
    state = engine.reset(start)
    with pytest.raises(SimError, match=f"room for 1 {name} a world"):
        engine.step(state, Command(np.asarray(state.qpos[:, scene.arm]), -np.ones(WORLDS)))


def test_a_contact_that_is_lost_for_good_loses_its_world_alone(lift, scene, start, monkeypatch):
    """Warp's flag of a full EPA horizon: more room would not help, and the physics is wrong."""
    step, there = mjx.step, jnp.asarray(start.qpos[2], jnp.float32)

    def flagged(model, data):
        after = step(model, data)
        lost = jnp.where(abs(data.qpos - there).max() < 1e-6, LOST_FOR_GOOD, 0)
        return after.tree_replace({"_impl.overflow": after._impl.overflow | lost})

    monkeypatch.setattr(mjx, "step", flagged)
    assert OverflowType.EPA_HORIZON == LOST_FOR_GOOD
    engine = MjxEngine(scene, "joint_position", lift.varied)
    state = engine.reset(start)
    command = Command(np.asarray(state.qpos[:, scene.arm]) + 0.1, -np.ones(WORLDS))
    after = engine.step(state, command)
    assert after.ok.tolist() == [world != 2 for world in range(WORLDS)]
    moved = abs(np.asarray(after.qpos) - np.asarray(state.qpos)).max(1) > 0
    assert moved.tolist() == after.ok.tolist()


def test_engines_by_name(lift, scene):
    assert engine_name("auto", scene) == "native"
    assert isinstance(make_engine("auto", scene, "osc_pose", lift.varied), NativeEngine)
    assert make_engine("mjx-warp", scene, "joint_position", lift.varied).controller != "osc_pose"
    with pytest.raises(ConfigError, match="mjx-warp"):
        make_engine("mjx-wrap", scene, "osc_pose")


def replayed(engine, demos, lift, scene, extra=0):
    """Expert demonstrations' commands, the last one kept for `extra` steps more."""
    start = starts_of(demos)
    moves = np.zeros((len(demos), max(d.length for d in demos) + extra, 7))
    moves[..., -1] = 1
    for row, demo in zip(moves, demos, strict=True):
        row[: demo.length] = demo_actions(demo, "eef_delta", scene)
    anchor = np.asarray(measured("eef_delta", engine.reset(start), scene.arm), float)
    return start, Command(*decode("eef_delta", moves, anchor, scene.nominal_grip))


@pytest.mark.slow
def test_a_held_cube_does_not_creep_out_of_the_grasp(demos, lift, scene):
    """For a whole episode after the lift: MJX has no noslip iterations."""
    engine = MjxEngine(scene, "osc_pose", lift.varied)
    some = demos.train[:2]
    start, commands = replayed(engine, some, lift, scene, extra=lift.horizon)
    way, progress = follow(engine, start, commands)
    cube = scene.qpos_of("cube")
    assert progress.state.ok.all()
    held = way[-lift.horizon + 20 :, :, cube : cube + 3]
    assert (held[..., 2] > 0.86).all()
    assert abs(held - held[0]).max() < 2e-3


@pytest.mark.slow
def test_demonstrations_succeed_as_on_the_native_engine(demos, lift, scene):
    episodes = demos.episodes
    outcomes = []
    for engine in (NativeEngine(scene, varied=lift.varied), MjxEngine(scene, varied=lift.varied)):
        start, commands = replayed(engine, episodes, lift, scene)
        outcomes.append(
            np.asarray(follow(engine, start, commands, lift.success_in(scene))[1].success)
        )
    assert outcomes[0].all()
    np.testing.assert_array_equal(*outcomes)


@pytest.mark.slow
@pytest.mark.timeout(3000)  # a busy machine compiles for longer than other tests may take
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_mjx_jax_is_as_native(lift, scene, start, controller):
    engine = MjxEngine(scene, controller, lift.varied, "jax")
    assert_as_native(engine, controller, lift, scene, start, steps=50)
