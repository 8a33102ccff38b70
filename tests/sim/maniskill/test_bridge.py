"""ManiSkill's worlds through the bridge: states, controllers, pictures, and children that die."""

import logging
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from running import exit_code

from jaxcam.data.collection import run_expert
from jaxcam.errors import ConfigError, SimError
from jaxcam.rays import Camera, look_at
from jaxcam.rays.rotations import matrix_from_quaternion, matrix_from_rotvec, rotvec_from_matrix
from jaxcam.sim import make_engine, make_painter, make_task
from jaxcam.sim.maniskill import kinematics, machine
from jaxcam.sim.maniskill import pool as pool_module
from jaxcam.sim.maniskill.kinematics import forward, inverse
from jaxcam.sim.maniskill.pool import Child, pool_of
from jaxcam.sim.maniskill.scene import HOME
from jaxcam.sim.rollout import Agent, Episodes, rollout
from jaxcam.sim.task import starts
from jaxcam.sim.types import Command, View

WORLDS = 3
HALF = 0.02
"""Half-size (m) of Push's cube."""
HEIGHT, WIDTH = 96, 128
K = np.array([[210.0, 0, 70], [0, 190, 44], [0, 0, 1]])


@pytest.fixture(scope="module")
def push():
    return make_task("push")


@pytest.fixture(scope="module")
def world(maniskill, push):
    return push.scene("randomized")


@pytest.fixture(scope="module")
def start(push, world):
    return starts(push, world, range(WORLDS))


@pytest.fixture(scope="module")
def engine(world):
    return make_engine("auto", world, "osc_pose")


@pytest.fixture(scope="module")
def joint_engine(world):
    return make_engine("sapien", world, "joint_position")


def hold(state, **kwargs):
    """Commands that keep grips where they are."""
    pose = np.concatenate([state.grip_position, rotvec_from_matrix(state.grip_rotation)], -1)
    return Command(pose, kwargs.get("gripper", np.ones(len(pose))))


def same(a, b):
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def test_the_jacobian_is_the_derivative():
    q = HOME + np.random.default_rng(0).normal(0, 0.3, (4, 7))
    position, rotation, jacobian = forward(q)
    for i in range(7):
        moved, turned, _ = forward(q + 1e-6 * np.eye(7)[i])
        np.testing.assert_allclose((moved - position) / 1e-6, jacobian[:, :3, i], atol=1e-5)
        turn = rotvec_from_matrix(turned @ rotation.mT) / 1e-6
        np.testing.assert_allclose(turn, jacobian[:, 3:, i], atol=1e-5)


def test_inverse_kinematics_reaches_and_stays_within_limits():
    rng = np.random.default_rng(1)
    q = HOME + rng.normal(0, 0.1, (50, 7))
    goal, axes, _ = forward(np.clip(q + rng.normal(0, 0.1, q.shape), *kinematics.LIMITS))
    solution = inverse(goal, axes, q, q)
    at, turned, _ = forward(solution)
    assert np.linalg.norm(at - goal, axis=-1).max() < 1e-4
    assert np.linalg.norm(rotvec_from_matrix(turned @ axes.mT), axis=-1).max() < 1e-3
    far = inverse(goal + np.array([2.0, 0, 0]), axes, q, q)  # out of reach: near, and no leaps
    assert np.isfinite(far).all()
    assert (far >= kinematics.LIMITS[0]).all()
    assert (far <= kinematics.LIMITS[1]).all()


def test_a_reset_is_what_was_asked_and_repeats(engine, start, world):
    state = engine.reset(start)
    np.testing.assert_allclose(state.qpos, start.qpos, atol=1e-6)  # SAPIEN's are float32
    assert not state.qvel.any()
    np.testing.assert_array_equal(state.closed, -1)
    base = world.world_from_base
    position, rotation, _ = forward(state.qpos[:, world.arm])
    np.testing.assert_allclose(
        position @ base[:3, :3].T + base[:3, 3], state.grip_position, atol=1e-5
    )
    np.testing.assert_allclose(base[:3, :3] @ rotation, state.grip_rotation, atol=1e-5)
    for _ in range(3):
        engine.step(state, hold(state))
    assert same(engine.reset(start), state)


def push_on(engine, world, start, steps=30):
    """Drives the grips down and against the cubes: every contact there is."""
    state = engine.reset(start)
    cube = world.qpos_of("cube")
    for t in range(steps):
        target = state.qpos[:, cube : cube + 3] + [0, 0, 0.1 if t < steps // 2 else 0.0]
        pose = np.concatenate([target, rotvec_from_matrix(state.grip_rotation)], -1)
        state = engine.step(state, Command(pose, np.ones(len(pose))))
    return state


def test_episodes_repeat_to_the_last_bit(engine, push, world, start):
    first = push_on(engine, world, start)
    assert np.abs(first.qpos[:, 9:12] - start.qpos[:, 9:12]).max() > 1e-3  # cubes have moved
    for _ in range(3):
        push_on(engine, world, starts(push, world, range(5, 5 + WORLDS)), steps=24)
        assert same(push_on(engine, world, start), first)


def test_worlds_do_not_depend_on_how_many_there_are_nor_on_their_process(engine, push, world):
    many = starts(push, world, range(9))
    assert len(pool_of(world).children(9)) == min(2, os.cpu_count() or 1)
    all_of_them = push_on(engine, world, many, steps=20)
    some = push_on(engine, world, starts(push, world, range(5, 8)), steps=20)
    assert same([x[5:8] for x in all_of_them], some)


def test_the_grip_goes_where_it_is_told_and_fingers_close(engine, start, world):
    state = engine.reset(start)
    turn = matrix_from_rotvec(np.array([0.1, 0.2, -0.3]))
    rotation = turn @ state.grip_rotation
    pose = np.concatenate(
        [state.grip_position + np.array([0.04, -0.05, 0.06]), rotvec_from_matrix(rotation)], -1
    )
    for _ in range(30):
        state = engine.step(state, Command(pose, np.ones(WORLDS)))
    assert np.linalg.norm(state.grip_position - pose[:, :3], axis=-1).max() < 1e-3
    error = rotvec_from_matrix(rotation @ state.grip_rotation.mT)
    assert np.linalg.norm(error, axis=-1).max() < 5e-3
    np.testing.assert_allclose(state.qpos[:, world.fingers], 0, atol=1e-3)
    np.testing.assert_array_equal(state.closed, 1)
    state = engine.step(state, Command(pose, np.zeros(WORLDS)))
    np.testing.assert_array_equal(state.closed, 1)  # no sign: as before


def test_joints_trail_their_targets_by_the_lag_that_actions_count_with(joint_engine, start, world):
    state = joint_engine.reset(start)
    speed = 0.4 * np.eye(7)[0]
    for t in range(30):
        target = start.qpos[:, :7] + speed * (t + 1) / 20
        state = joint_engine.step(state, Command(target, -np.ones(WORLDS)))
    lag = (target - state.qpos[:, :7])[:, 0] / 0.4
    np.testing.assert_allclose(lag, world.joint_lag, rtol=0.05)


def test_worlds_that_are_not_active_stay_and_others_are_put_where_a_state_says(engine, start):
    before = engine.reset(start)
    active = np.array([True, False, True])
    after = engine.step(before, hold(before), active)
    assert same([x[1] for x in after], [x[1] for x in before])
    assert (after.qvel[0] != before.qvel[0]).any()
    mixed = type(after)(*(x[[2, 1, 0]] for x in after))  # worlds 0 and 2 swap places
    there = engine.step(mixed, hold(mixed))
    straight = engine.step(after, hold(after))
    np.testing.assert_allclose(there.qpos[2], straight.qpos[0], atol=1e-4)
    np.testing.assert_allclose(there.qpos[0], straight.qpos[2], atol=1e-4)


MANISKILL = """
import numpy as np, gymnasium, jaxcam.sim.maniskill.envs
from jaxcam.sim.task import starts
env = gymnasium.make("JaxcamPush-v1", scene="randomized", sim_backend="physx_cpu",
                     render_backend="none", obs_mode="none", control_mode="pd_joint_pos")
env.reset(seed=0)
env = env.unwrapped
env.begin(starts(env.task, env.world, [0]))
reached = []
for action in np.load("actions.npy"):
    env.step(action[None])
    state = env.state()
    reached.append(np.concatenate([state.qpos[0], state.qvel[0]]))
np.save("reached.npy", reached)
"""


def test_a_control_step_is_maniskills_own(joint_engine, push, world, tmp_path):
    start = starts(push, world, [0])
    targets = start.qpos[0, :7] + np.linspace(0, 1, 25)[:, None] * [0.2, -0.4, 0, 0.1, 0, 0.3, 0]
    np.save(tmp_path / "actions.npy", np.c_[targets, np.ones(25)].astype(np.float32))
    subprocess.run(
        [sys.executable, "-W", "ignore", "-c", MANISKILL], cwd=tmp_path, check=True,
        env=machine.child_environment(), capture_output=True,
    )  # fmt: skip
    state, rows = joint_engine.reset(start), []
    for target in targets:  # fingers open: in touch, their order would matter
        state = joint_engine.step(state, Command(target[None], -np.ones(1)))
        rows.append(np.concatenate([state.qpos[0], state.qvel[0]]))
    np.testing.assert_allclose(rows, np.load(tmp_path / "reached.npy"), atol=1e-4)


def views(start, count=4):
    """The first episode seen from around its cube, near the grip's height."""
    angles = np.linspace(-1.2, 1.2, count)
    eyes = np.stack([0.6 * np.cos(angles), 0.6 * np.sin(angles), np.full(count, 0.35)], -1)
    poses = np.asarray(look_at(eyes, np.array([-0.05, 0.0, 0.08])))
    repeated = [np.repeat(x[:1], count, 0) for x in start]
    return View(*repeated, np.repeat(K[None], count, 0), poses)


@pytest.fixture(scope="module")
def layers(world, start):
    return make_painter(world, HEIGHT, WIDTH).layers(views(start))


def test_unprojected_depth_lies_on_the_cube(layers, start, world):
    """One ray of ours per pixel, as long as SAPIEN says: its end is on a face of the cube."""
    view, cube = views(start), world.qpos_of("cube")
    number = next(i for i, name in enumerate(layers.names) if name.endswith("cube"))
    pose = start.qpos[0, cube : cube + 7]
    count = 0
    for i, world_from_camera in enumerate(view.world_from_camera):
        rays = np.asarray(Camera(K, world_from_camera, HEIGHT, WIDTH).plucker(), float)
        hit = layers.segments[i] == number
        count += hit.sum()
        direction = rays[hit][:, :3]
        along = direction / (direction @ world_from_camera[:3, 2])[:, None]
        points = world_from_camera[:3, 3] + layers.depth[i][hit][:, None] * along
        local = abs((points - pose[:3]) @ matrix_from_quaternion(pose[3:]))
        to_face = abs(local.max(-1) - HALF)
        assert to_face.max() < 2e-3
        assert local.max() < HALF + 2e-3
    assert count > 200


def test_the_fingers_are_where_they_are_predicted(layers, start, engine):
    """The middle of the fingers' pixels, against the projection of the point between them."""
    state, view = engine.reset(start), views(start)
    numbers = [i for i, name in enumerate(layers.names) if name.endswith("finger")]
    assert len(numbers) == 2
    middle = state.grip_position[0] - 0.017 * state.grip_rotation[0][:, 2]  # of their meshes
    for i, world_from_camera in enumerate(view.world_from_camera):
        pixels = np.argwhere(np.isin(layers.segments[i], numbers))[:, ::-1] + 0.5
        assert len(pixels) > 30
        u, v, w = K @ (world_from_camera[:3, :3].T @ (middle - world_from_camera[:3, 3]))
        assert np.linalg.norm(pixels.mean(0) - [u / w, v / w]) < 3


def test_pictures_repeat_and_show_states_and_cameras(world, start, layers):
    painter, view = make_painter(world, HEIGHT, WIDTH), views(start)
    pictures = painter.rgb(view)
    assert pictures.dtype == np.uint8
    assert pictures.shape == (4, HEIGHT, WIDTH, 3)
    np.testing.assert_array_equal(pictures, layers.rgb)
    np.testing.assert_array_equal(painter.rgb(view._replace(**{k: v[::-1] for k, v in zip(
        view._fields, view, strict=True)}))[::-1], pictures)  # fmt: skip
    moved = view.fixtures.copy()
    moved[:, 2, 0] += 0.1  # the target
    assert (painter.rgb(view._replace(fixtures=moved)) != pictures).any()
    assert (pictures[0] != pictures[1]).any()


def test_a_camera_that_sapien_cannot_have_is_an_error(world, start):
    view = views(start, 1)
    mirrored = view.world_from_camera * np.array([-1.0, 1, 1, 1])
    with pytest.raises(SimError, match="not the one that was asked"):
        make_painter(world, HEIGHT, WIDTH).rgb(view._replace(world_from_camera=mirrored))


def test_the_expert_and_a_policy_run_as_in_mujoco(push, world, engine, start):
    demos = run_expert(push, world, engine, [0, 1])
    assert all(demo is not None for demo in demos)
    asked = []

    def act(obs, call):
        asked.append(obs)
        return np.zeros((WORLDS, 50, 7))

    episodes = Episodes(
        start,
        np.repeat(K[None, None], WORLDS, 0),
        np.repeat(views(start).world_from_camera[None, :1], WORLDS, 0),
    )
    done = rollout(Agent(act, "eef_delta"), push, engine, make_painter(world, 32), episodes)
    assert done.ok.all()
    assert not done.success.any()
    assert len(asked) == push.horizon // 50
    assert asked[0]["image"].shape == (WORLDS, 1, 32, 32, 3)
    assert asked[0]["image"].std() > 10
    np.testing.assert_allclose(done.qpos[-1], done.qpos[0], atol=0.02)  # deltas of nothing


def test_a_child_that_dies_is_replaced_once_and_its_last_words_are_told(world, caplog, monkeypatch):
    child = Child(world)
    child.ask("hello")
    about = child.answer()
    child.ask("juggle")
    with pytest.raises(SimError, match="no attribute 'juggle'"):
        child.answer()
    os.kill(child.pid, signal.SIGABRT)
    with caplog.at_level(logging.WARNING):
        child.ask("hello")
        assert child.answer() == about
    assert "started anew" in caplog.text
    assert "Fatal Python error: Aborted" in caplog.text
    os.kill(child.pid, signal.SIGSTOP)
    monkeypatch.setattr(pool_module, "STALL", 1.0)
    child.ask("load", [0])
    with pytest.raises(SimError, match=r"(?s)has hung: no sign of work for 1 s.*last words"):
        child.answer()
    child.close()


def test_the_parent_never_loads_pytorch():
    code = """
import sys
import jaxcam.check, jaxcam.collect, jaxcam.evaluate, jaxcam.replay
from jaxcam.sim import make_task
for name in ("push", "lift_upright", "roll_ball"):
    make_task(name).scene("randomized")
import jaxcam.sim.maniskill.engine, jaxcam.sim.maniskill.render
assert not {"torch", "sapien", "mani_skill", "gymnasium"} & set(sys.modules)
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_other_engines_are_refused(push):
    with pytest.raises(ConfigError, match=r"'native' cannot step this task's world.*sapien"):
        make_engine("native", push.scene("fixed"), "osc_pose")
    with pytest.raises(ConfigError, match="'sapien' cannot step"):
        make_engine("sapien", make_task("lift").scene("fixed"), "osc_pose")


def test_what_is_missing_is_told_before_anything_starts(push, monkeypatch):
    monkeypatch.setattr(machine, "missing_packages", lambda: ["sapien"])
    with pytest.raises(SimError, match=r"sapien cannot be imported.*pip install .*maniskill"):
        push.require()


def test_a_machine_without_vulkan_is_told_how_to_get_it(maniskill, push, monkeypatch):
    monkeypatch.setenv("VK_ICD_FILENAMES", "/nowhere.json")
    machine.device.cache_clear()
    try:
        with pytest.raises(SimError, match=r"(?s)no Vulkan device.*apt-get install.*check --env"):
            push.require()
    finally:
        machine.device.cache_clear()


def test_check_tells_what_there_is_and_how_to_get_the_rest(monkeypatch, capsys):
    monkeypatch.setattr(machine, "missing_packages", lambda: list(machine.PACKAGES.values()))
    exit_code("check", "--env")
    printed = capsys.readouterr().out
    assert "extra maniskill: pip install 'jaxcam[maniskill]'" in printed
    assert "lift, pick_place_can, square" in printed
    assert "without mani-skill, sapien, torch" in printed
