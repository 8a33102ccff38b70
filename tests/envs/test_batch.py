"""Environments run what rollouts run: the same states, outcomes and observations."""

import numpy as np
import pytest

from jaxcam.data.batches import demo_actions
from jaxcam.data.collection import run_expert
from jaxcam.data.pairs import make_pairs
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.sim import make_engine, make_painter
from jaxcam.sim.rollout import Agent, Episodes, rollout

PIXELS, CHUNK, HORIZON = 16, 3, 8


def untrained(observation, size):
    """Chunks of a policy that sees everything: mixed from picture, camera and state."""
    count = len(observation["image"])
    names = [name for name in ("proprio", "state") if name in observation]
    inputs = np.concatenate(
        [
            observation["image"].reshape(count, -1) / 255,
            observation["base_from_camera"].reshape(count, -1),
            observation[names[0]],
        ],
        -1,
    )
    weights = np.random.default_rng(0).standard_normal((inputs.shape[1], CHUNK * size))
    return 0.02 * np.tanh(inputs @ weights).reshape(count, CHUNK, size).astype(np.float32)


@pytest.fixture(scope="module")
def roll(lift):
    """Rollouts on held-out test pairs, as an evaluation runs them."""
    scene = lift.scene("randomized")
    painter = make_painter(scene, PIXELS, varied=lift.varied, batch=2)

    class Short(type(lift)):
        horizon = HORIZON

    def roll(act, pairs, space="eef_delta", execute=None, views=1, horizon=HORIZON):
        task = Short()
        task.horizon = horizon
        chosen = make_pairs(lift, scene, views, "test", pairs)
        controller = "joint_position" if space.startswith("joint") else "osc_pose"
        engine = make_engine("native", scene, controller, lift.varied)
        K = np.tile(intrinsics(45, PIXELS), (len(pairs), views, 1, 1))
        episodes = Episodes(chosen.start, K, chosen.cameras)
        return rollout(Agent(act, space, execute), task, engine, painter, episodes)

    return roll


def steps_of(envs, act, options):
    """Positions at each step, and the last infos, of episodes stepped by `act(observation)`."""
    observation, infos = envs.reset(options=options)
    way, over = [envs.batch.now.progress.state.qpos], np.zeros(envs.num_envs, bool)
    while not over.all():
        observation, _, terminated, truncated, infos = envs.step(act(observation))
        over = terminated | truncated
        way.append(envs.batch.now.progress.state.qpos)
    return np.array(way), infos


@pytest.mark.parametrize("space", ["eef_delta", "joint_abs"])
def test_chunks_lead_to_the_states_of_a_rollout_to_the_last_bit(make_vec, roll, space):
    size = 8 if space == "joint_abs" else 7
    done = roll(lambda obs, call, *_: untrained(obs, size), [2, 3], space)
    envs = make_vec(
        num_envs=2, chunk=CHUNK, action_space=space, horizon=HORIZON, autoreset_mode="Disabled"
    )
    way, infos = steps_of(envs, lambda obs: untrained(obs, size), {"pair": 2})
    np.testing.assert_array_equal(way, done.qpos[[0, 3, 6, 8]])
    assert infos["steps"].tolist() == done.steps.tolist() == [HORIZON] * 2


@pytest.mark.parametrize("execute", [1, 2])
def test_so_do_single_actions(make_vec, roll, execute):
    """Exactly, where a rollout executes one; else deltas are summed in another order."""
    done = roll(lambda obs, call, *_: untrained(obs, 7), [4, 5], execute=execute, views=2)
    envs = make_vec(num_envs=2, views=2, horizon=HORIZON, autoreset_mode="Disabled")
    left = []

    def act(observation):
        left[:] = left or list(untrained(observation, 7)[:, :execute].swapaxes(0, 1))
        return left.pop(0)

    way, _ = steps_of(envs, act, {"pair": 4})
    compare = np.testing.assert_array_equal if execute == 1 else np.testing.assert_allclose
    compare(way, done.qpos, **({} if execute == 1 else {"atol": 1e-9}))


def test_an_expert_succeeds_in_both_at_the_same_step(make_vec, make, roll, lift):
    pair, horizon = 6, 120
    scene = lift.scene("randomized")
    engine = make_engine("native", scene, "osc_pose", lift.varied)
    demo = run_expert(lift, scene, engine, [1_000_000 + pair])[0]
    moves = demo_actions(demo, "eef_delta", scene)
    moves = np.concatenate([moves, np.tile(moves[-1:] * [0, 0, 0, 0, 0, 0, 1], (40, 1))])
    done = roll(
        lambda obs, call, *_: moves[None, call : call + 1], [pair], execute=1, horizon=horizon
    )
    assert done.success.all()
    env = make(horizon=horizon)
    env.reset(options={"pair": pair})
    rewards = []
    for action in moves[: done.steps[0]]:
        _, reward, terminated, truncated, info = env.step(action)
        rewards.append(reward)
    assert (terminated, truncated) == (True, False)
    assert rewards == [0.0] * (len(rewards) - 1) + [1.0]
    assert (info["success"], info["pair"], info["steps"]) == (True, pair, done.steps[0])
    envs = make_vec(num_envs=2, chunk=40, horizon=horizon, autoreset_mode="Disabled")
    chunks = np.stack([moves[:80].reshape(2, 40, 7), np.zeros((2, 40, 7))])
    turns = iter([0, 1, 1])
    way, infos = steps_of(envs, lambda _: chunks[:, next(turns)], {"pair": pair})
    assert infos["success"].tolist() == [True, False]
    assert infos["steps"].tolist() == [done.steps[0], horizon]
    np.testing.assert_allclose(way[-1][0], done.qpos[-1, 0], atol=1e-6)


def test_neighbours_that_begin_anew_do_not_matter(make_vec):
    """Neither to what is touched nor to what is seen: in contact with the table."""
    down = np.array([[0, 0, -0.04, 0, 0, 0, 1.0]] * 2)
    calm, busy = (make_vec(num_envs=2, horizon=40, autoreset_mode="Disabled") for _ in range(2))
    for envs in (calm, busy):
        envs.reset(options={"pair": 0})
    for step in range(16):
        if step % 3 == 2:
            mask = np.array([False, True])
            busy.reset(options={"pair": step, "reset_mask": mask})
        one, *_ = calm.step(down)
        other, *_ = busy.step(down)
        for name in one:
            np.testing.assert_array_equal(one[name][0], other[name][0])
    assert (one["state"][1] != other["state"][1]).any()
