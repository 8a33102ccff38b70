"""Rollouts: what a policy sees, when episodes end, and that neighbours do not matter."""

import numpy as np
import pytest

from jaxcam.data.batches import demo_actions
from jaxcam.rays import sample_poses
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.sim.mujoco.native import NativeEngine
from jaxcam.sim.rollout import Agent, Episodes, rollout
from jaxcam.sim.task import starts
from jaxcam.sim.tasks.lift import Lift
from jaxcam.sim.types import State, View

CHUNK = 10


class ShortLift(Lift):
    horizon = 7


@pytest.fixture
def run(lift, scene, renderer):
    def run(act, seeds, task=lift, views=1, execute=None, obs_steps=1):
        count = len(seeds)
        poses = sample_poses(lift.cameras, views * (max(seeds) + 1), 0)
        agent = Agent(act, "eef_delta", execute, obs_steps)
        episodes = Episodes(
            starts(lift, scene, seeds),
            np.tile(intrinsics(45, renderer.height), (count, views, 1, 1)),
            poses.reshape(-1, views, 4, 4)[seeds],
        )
        engine = NativeEngine(scene, varied=lift.varied)
        return rollout(agent, task, engine, renderer, episodes)

    return run


@pytest.fixture
def replay(demos, scene):
    """A policy that shows demonstrations again; where it has none it stays."""

    def policy(which):
        moves = np.zeros((len(which), 200, 7))
        for i, demo in enumerate(which):
            if demo is not None:
                actions = demo_actions(demo, "eef_delta", scene)
                moves[i, : len(actions)] = actions
                moves[i, len(actions) :, -1] = 1
        return lambda obs, call, active: moves[:, call * CHUNK : (call + 1) * CHUNK]

    return policy


def test_worlds_end_on_their_own_and_stay(run, replay, demos, lift, scene):
    some = demos.train[:2]
    done = run(replay([some[0], None, some[1]]), [some[0].seed, 7, some[1].seed])
    assert done.success.tolist() == [True, False, True]
    assert done.steps[1] == lift.horizon
    assert len(done.qpos) == lift.horizon + 1
    for i in (0, 2):
        last = done.steps[i]
        assert 10 < last < lift.horizon
        reached = lift.success(scene, State(done.qpos[:, i], *[None] * 7), None)
        assert reached[last]
        assert not reached[:last].any()
        assert (done.qpos[last:, i] == done.qpos[last, i]).all()
    alone = run(replay([some[1]]), [some[1].seed])
    assert alone.steps[0] == done.steps[2]
    np.testing.assert_array_equal(alone.qpos[: last + 1, 0], done.qpos[: last + 1, 2])


def test_a_policy_that_returns_nan_loses_its_own_episode_only(run, replay, demos):
    demo = demos.train[0]
    healthy = replay([demo, None])

    def act(obs, call, active):
        chunk = healthy(obs, call, active).copy()
        if call == 1:
            chunk[1, 3, 2] = np.nan
        return chunk

    done = run(act, [demo.seed, 7])
    assert done.success.tolist() == [True, False]
    assert done.ok.tolist() == [True, True]  # the simulator is not at fault
    assert done.acted.tolist() == [True, False]
    assert np.isfinite(done.qpos).all()
    assert (done.qpos[CHUNK:, 1] == done.qpos[CHUNK, 1]).all()


def test_nan_after_success_does_not_undo_it(run, replay, demos):
    demo = demos.train[0]
    healthy = replay([demo, None])
    first = int(run(replay([demo]), [demo.seed]).steps[0])

    def act(obs, call, active):
        chunk = healthy(obs, call, active).copy()
        if call * CHUNK >= first:
            chunk[0] = np.nan
        return chunk

    done = run(act, [demo.seed, 7])
    assert done.success[0]
    assert done.ok.all()


@pytest.mark.parametrize(("execute", "calls"), [(None, 1), (3, 3)])
def test_horizon_cuts_and_chunks_are_executed_open_loop(run, execute, calls):
    called = []

    def act(obs, call, active):
        called.append(call)
        return np.tile(np.array([0.01, 0, 0, 0, 0, 0, -1.0]), (2, CHUNK, 1))

    ticks = run(act, [0, 1], ShortLift(), execute=execute)
    assert called == list(range(calls))
    assert ticks.steps.tolist() == [7, 7]
    assert len(ticks.qpos) == 8
    assert not ticks.success.any()


def test_what_the_policy_sees(run, lift, scene, renderer):
    seeds, views = [3, 1], 2
    observed = []

    def act(obs, call, active):
        observed.append(obs)
        return np.zeros((2, 4, 7))

    run(act, seeds, ShortLift(), views=views)
    obs, start = observed[0], starts(lift, scene, seeds)
    poses = sample_poses(lift.cameras, 8, 0).reshape(-1, views, 4, 4)[seeds]
    np.testing.assert_allclose(scene.world_from_base @ obs["base_from_camera"], poses, atol=1e-6)
    np.testing.assert_allclose(obs["proprio"][:, :7], start.qpos[:, scene.arm], atol=1e-6)
    assert obs["K"].shape == (2, views, 3, 3)
    assert [obs[k].dtype for k in ("image", "K", "proprio")] == [np.uint8, np.float32, np.float32]
    for i in range(2):
        for v in range(views):
            fresh = View(
                *(x[[i]] for x in start), obs["K"][i, v][None].astype(float), poses[i, v][None]
            )
            np.testing.assert_array_equal(obs["image"][i, v], renderer.rgb(fresh)[0])
    assert (observed[1]["image"] != obs["image"]).any()


@pytest.mark.parametrize(("obs_steps", "execute"), [(2, 3), (3, 2), (3, 1)])
def test_several_observations_are_of_the_steps_before(run, scene, renderer, obs_steps, execute):
    observed = []

    def act(obs, call, active):
        observed.append(obs)
        return np.tile(np.array([0.02, 0, 0, 0, 0, 0, -1.0]), (2, CHUNK, 1))

    done = run(act, [0, 1], ShortLift(), execute=execute, obs_steps=obs_steps)
    assert len(done.qpos) == 8
    assert observed[0]["image"].shape == (2, obs_steps, 1, renderer.height, renderer.width, 3)
    for call, obs in enumerate(observed):
        for s in range(obs_steps):
            t = max(0, call * execute + s - (obs_steps - 1))
            np.testing.assert_allclose(
                obs["proprio"][:, s, :7], done.qpos[t][:, scene.arm], atol=1e-6
            )
    assert (observed[-1]["image"][:, 0] != observed[-1]["image"][:, -1]).any()
