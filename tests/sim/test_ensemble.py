"""Temporal ensembling against its definition, the golden weights and LeRobot's; in rollouts too."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.tree_util import Partial
from places import GOLDEN
from scipy.spatial.transform import Rotation

from jaxcam.rays import sample_poses
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.rays.rotations import nearest_rotation
from jaxcam.sim.actions import averageable, averaged
from jaxcam.sim.ensemble import ensemble
from jaxcam.sim.mujoco.mjx import MjxEngine
from jaxcam.sim.mujoco.native import NativeEngine
from jaxcam.sim.rollout import Agent, Episodes, rollout
from jaxcam.sim.task import starts
from jaxcam.sim.tasks.lift import Lift

HORIZON, CHUNK = 6, 4


class ShortLift(Lift):
    horizon = HORIZON


def run(chunks, rate):
    mean, actions = np.zeros_like(chunks[0]), []
    for call, chunk in enumerate(chunks):
        action, mean = ensemble(mean, chunk, np.array(call), rate)
        actions.append(action)
    return np.stack(actions)


def weights(count, rate):
    raw = np.exp(-rate * np.arange(count))
    return raw / raw.sum()


def said(chunks, t):
    """All that was predicted for step t, the oldest first [n, B, N]."""
    length = chunks[0].shape[1]
    return np.stack([chunks[s][:, t - s] for s in range(max(0, t - length + 1), t + 1)])


def test_golden_weights():
    """The mean of unit vectors, one a prediction, is the weights themselves."""
    chunks = np.eye(100)[:, None, None].repeat(100, 2)
    got = run(chunks, 0.01)[99, 0]
    expected = json.loads((GOLDEN / "schedules.json").read_text())["act_temporal_agg_n100_k0.01"]
    assert got.sum() == pytest.approx(1)
    assert [got[0], got[1], got[-1]] == pytest.approx(list(expected.values()))


@pytest.mark.parametrize("rate", [-0.3, 1e-9, 0.01, 0.5])
def test_an_action_is_the_mean_of_all_that_was_predicted_for_it(rate):
    chunks = np.random.default_rng(0).normal(size=(9, 2, 4, 3))
    for t, action in enumerate(run(chunks, rate)):
        one = said(chunks, t)
        np.testing.assert_allclose(action, np.tensordot(weights(len(one), rate), one, 1), rtol=1e-9)


def test_actions_equal_lerobots():
    golden = np.load(GOLDEN / "act_public.npz")
    actions = run(golden["ensemble/chunks"], 0.01)
    np.testing.assert_allclose(actions, golden["ensemble/actions"], rtol=1e-5, atol=1e-6)


def test_jitted_is_the_same():
    chunks = np.random.default_rng(1).normal(size=(7, 2, 4, 3)).astype(np.float32)
    expected = run(chunks, 0.1)

    def one(carried, chunk):
        mean, call = carried
        action, mean = ensemble(mean, chunk, call, 0.1)
        return (mean, call + 1), action

    first = (jnp.zeros_like(chunks[0]), jnp.int32(0))
    got = jax.jit(lambda chunks: jax.lax.scan(one, first, chunks)[1])(chunks)
    np.testing.assert_allclose(got, expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("xp", [np, jnp])
def test_rotations_are_averaged_on_their_manifold(xp):
    """On either side of half a turn, rotation vectors are opposite and their mean is nothing."""
    rotvecs = np.stack([[np.pi - 0.1, 0, 0.02], [-np.pi + 0.14, 0, 0.01], [3.0, 0.2, 0.1]])
    share = np.array([0.5, 0.3, 0.2])
    targets = np.concatenate([np.arange(9.0).reshape(3, 3), rotvecs], -1)
    mean = share @ averageable("eef_abs", targets, np.array([1.0, 1, -1]))
    target, gripper = averaged("eef_abs", xp.asarray(mean))
    np.testing.assert_allclose(target[:3], share @ targets[:, :3], rtol=1e-6)
    assert gripper == pytest.approx(0.6)
    expected = Rotation.from_rotvec(rotvecs).mean(share)
    got = Rotation.from_rotvec(np.asarray(target[3:]))
    assert (expected.inv() * got).magnitude() < 1e-6
    assert got.magnitude() > 3


def test_a_mirror_is_no_rotation():
    mirrored = nearest_rotation(np.diag([1.0, 1.0, -0.5]))
    assert np.linalg.det(mirrored) == pytest.approx(1)
    np.testing.assert_allclose(mirrored @ mirrored.T, np.eye(3), atol=1e-12)


class Recorder(NativeEngine):
    """Remembers its commands."""

    def __init__(self, *args):
        super().__init__(*args)
        self.commands = []

    def step(self, state, command, active=None):
        self.commands.append(command)
        return super().step(state, command, active)


def roll(act, engine, lift, scene, renderer, space, **how):
    episodes = Episodes(
        starts(lift, scene, [3, 1]),
        np.tile(intrinsics(45, renderer.height), (2, 1, 1, 1)),
        sample_poses(lift.cameras, 2, 0)[:, None],
    )
    return rollout(Agent(act, space, **how), ShortLift(), engine, renderer, episodes)


def near(lift, scene):
    """Chunks [call, B, T, 7] of absolute poses that call and step tell apart, half a turn away."""
    noise = np.random.default_rng(0).normal(size=(HORIZON, 2, CHUNK, 7)) * 0.05
    start = NativeEngine(scene, "osc_pose", lift.varied).reset(starts(lift, scene, [3, 1]))
    chunks = noise + np.array([0, 0, 0, np.pi, 0, 0, -1.0])
    chunks[..., :3] += start.grip_position[:, None]
    return chunks


def test_a_rollout_executes_means_of_absolute_targets(lift, scene, renderer):
    chunks, rate = near(lift, scene), 0.3
    engine = Recorder(scene, "osc_pose", lift.varied)
    roll(
        lambda obs, call, active: chunks[call], engine, lift, scene, renderer, "eef_abs_world",
        execute=CHUNK, ensembling=rate,
    )  # fmt: skip
    assert len(engine.commands) == HORIZON
    for t, command in enumerate(engine.commands):
        one = said(chunks, t)
        share = weights(len(one), rate)
        np.testing.assert_allclose(command.target[:, :3], np.tensordot(share, one[..., :3], 1))
        np.testing.assert_allclose(command.gripper, np.tensordot(share, one[..., 6], 1))
        for b in range(2):
            expected = Rotation.from_rotvec(one[:, b, 3:6]).mean(share)
            got = Rotation.from_rotvec(command.target[b, 3:])
            assert (expected.inv() * got).magnitude() < 1e-6


def test_means_are_of_rotations_whatever_they_are_counted_from(lift, scene, renderer):
    """The same poses as numbers of either space are averaged to the same commands."""
    chunks, runs = near(lift, scene), []
    poses = Rotation.from_rotvec(chunks[..., 3:6].reshape(-1, 3))
    turned = poses * Rotation.from_matrix(scene.nominal_grip.T)
    nominal = chunks.copy()
    nominal[..., 3:6] = turned.as_rotvec().reshape(nominal[..., 3:6].shape)
    for space, numbers in (("eef_abs_world", chunks), ("eef_abs", nominal)):
        engine = Recorder(scene, "osc_pose", lift.varied)
        act = iter(numbers)
        roll(
            lambda obs, call, active, act=act: next(act), engine, lift, scene, renderer, space,
            execute=CHUNK, ensembling=0.3,
        )  # fmt: skip
        runs.append(np.stack([command.target for command in engine.commands]))
    np.testing.assert_allclose(runs[1][..., :3], runs[0][..., :3])
    one, other = (Rotation.from_rotvec(run[..., 3:].reshape(-1, 3)) for run in runs)
    assert (one.inv() * other).magnitude().max() < 1e-6


@pytest.mark.parametrize("space", ["eef_delta", "joint_delta"])
def test_agreeing_deltas_give_what_open_loop_gives(lift, scene, renderer, space):
    """Deltas are added up before they are averaged, from the target that was executed last."""
    joint = space == "joint_delta"
    step = np.full((2, CHUNK, 8 if joint else 7), 0.02)
    controller = "joint_position" if joint else "osc_pose"
    runs = []
    for how in ({"execute": 2}, {"execute": CHUNK, "ensembling": 0.01}):
        engine = Recorder(scene, controller, lift.varied)
        done = roll(lambda obs, call, active: step, engine, lift, scene, renderer, space, **how)
        runs.append(done.qpos)
    np.testing.assert_allclose(runs[1], runs[0], atol=1e-6)


def test_a_compiled_rollout_is_the_same(lift, scene, mjx_renderer):
    chunks = near(lift, scene).astype(np.float32)
    act = Partial(lambda chunks, obs, call, active: chunks[call], jnp.asarray(chunks))
    how = {"execute": CHUNK, "ensembling": 0.3}
    qpos = [
        roll(act, engine, lift, scene, mjx_renderer, "eef_abs_world", **how).qpos
        for engine in (
            NativeEngine(scene, "osc_pose", lift.varied),
            MjxEngine(scene, "osc_pose", lift.varied),
        )
    ]
    np.testing.assert_allclose(qpos[1], qpos[0], atol=1e-3)
    assert abs(qpos[0][-1] - qpos[0][0]).max() > 0.01
