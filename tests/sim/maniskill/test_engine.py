"""ManiSkill's physics through the bridge: states, controllers, and that all of it repeats."""

import os
import subprocess
import sys

import numpy as np
import pytest
from sapien_views import WORLDS, K, views

from jaxcam.data.collection import run_expert
from jaxcam.errors import ConfigError
from jaxcam.rays.rotations import matrix_from_rotvec, rotvec_from_matrix
from jaxcam.sim import make_engine, make_painter, make_task
from jaxcam.sim.maniskill import machine
from jaxcam.sim.maniskill.kinematics import forward
from jaxcam.sim.maniskill.pool import pool_of
from jaxcam.sim.rollout import Agent, Episodes, rollout
from jaxcam.sim.task import starts
from jaxcam.sim.types import Command


def hold(state, **kwargs):
    """Commands that keep grips where they are."""
    pose = np.concatenate([state.grip_position, rotvec_from_matrix(state.grip_rotation)], -1)
    return Command(pose, kwargs.get("gripper", np.ones(len(pose))))


def same(a, b):
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


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


def test_worlds_begin_anew_without_a_trace_in_the_others(engine, world, start):
    """Their contacts are kept, which would be lost if they were put where they are."""
    again = np.arange(len(start.qpos)) == 1
    states = []
    for restarts in (False, True):
        state = push_on(engine, world, start, steps=20)
        if restarts:
            state = engine.restart(state, start, again)
            np.testing.assert_allclose(state.qpos[1], start.qpos[1], atol=1e-6)
            assert (state.qvel[1] == 0).all()
        for _ in range(5):
            state = engine.step(state, hold(state))
        states.append(state)
    for calm, busy in zip(*states, strict=True):
        np.testing.assert_array_equal(calm[~again], busy[~again])


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


def test_the_expert_and_a_policy_run_as_in_mujoco(push, world, engine, start):
    demos = run_expert(push, world, engine, [0, 1])
    assert all(demo is not None for demo in demos)
    asked = []

    def act(obs, call, active):
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


def test_other_engines_are_refused(push):
    with pytest.raises(ConfigError, match=r"'native' cannot step this task's world.*sapien"):
        make_engine("native", push.scene("fixed"), "osc_pose")
    with pytest.raises(ConfigError, match="'sapien' cannot step"):
        make_engine("sapien", make_task("lift").scene("fixed"), "osc_pose")
