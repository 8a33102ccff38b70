"""Four action spaces: there and back, chunk by chunk, and executed in the simulator."""

from typing import get_args

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcam.config.names import ActionSpace
from jaxcam.data.batches import demo_actions
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.rays.rotations import matrix_from_rotvec, rotvec_from_matrix
from jaxcam.sim.actions import (
    ACTION_SPACES,
    action_dim,
    controller_of,
    decode,
    encode,
    is_joint,
)
from jaxcam.sim.mujoco.native import NativeEngine
from jaxcam.sim.rollout import Agent, Episodes, rollout
from jaxcam.sim.task import starts

LENGTH = 24
SPACES = get_args(ActionSpace)


def trajectory(space, rng):
    """Targets, gripper signs and start; grip orientations about half a turn away from zero."""
    gripper = np.where(rng.random(LENGTH) < 0.5, -1.0, 1.0)
    if is_joint(space):
        path = np.cumsum(0.05 * rng.normal(size=(LENGTH + 1, 7)), 0)
        return path[1:], gripper, path[0]
    position = np.cumsum(0.02 * rng.normal(size=(LENGTH + 1, 3)), 0)
    rotation = [matrix_from_rotvec(np.array([np.pi, 0, 0]))]
    for _ in range(LENGTH):
        rotation.append(matrix_from_rotvec(0.2 * rng.normal(size=3)) @ rotation[-1])
    path = np.concatenate([position, rotvec_from_matrix(np.stack(rotation))], -1)
    assert np.linalg.norm(path[:, 3:], axis=-1).max() > 3.1
    return path[1:], gripper, path[0]


def assert_same_targets(space, found, expected):
    if is_joint(space):
        np.testing.assert_allclose(found, expected, atol=1e-12)
        return
    np.testing.assert_allclose(found[..., :3], expected[..., :3], atol=1e-12)
    # As matrices: at half a turn two rotation vectors name one rotation.
    rotations = (matrix_from_rotvec(x[..., 3:]) for x in (found, expected))
    np.testing.assert_allclose(*rotations, atol=1e-7)


@pytest.mark.parametrize("space", SPACES)
def test_there_and_back_at_once_and_chunk_by_chunk(space):
    rng = np.random.default_rng(0)
    batch = [trajectory(space, rng) for _ in range(3)]
    targets, signs, start = (np.stack(x) for x in zip(*batch, strict=True))
    actions = np.stack([encode(space, *each) for each in batch])
    assert actions.shape == (3, LENGTH, action_dim(space))
    whole, gripper = decode(space, actions, start)
    assert_same_targets(space, whole, targets)
    np.testing.assert_array_equal(gripper, signs)
    anchor, parts = start, []
    for first, last in ((0, 1), (1, 9), (9, LENGTH)):
        part, _ = decode(space, actions[:, first:last], anchor)
        parts.append(part)
        anchor = part[:, -1]
    assert_same_targets(space, np.concatenate(parts, 1), whole)


def test_small_moves_give_small_deltas_across_half_a_turn():
    targets, gripper, start = trajectory("eef_delta", np.random.default_rng(1))
    actions = encode("eef_delta", targets, gripper, start)
    jumps = np.linalg.norm(np.diff(targets[:, 3:], axis=0), axis=-1)
    assert jumps.max() > 3  # the vectors themselves flip their sign
    assert np.linalg.norm(actions[:, 3:6], axis=-1).max() < 1


def test_delta_rotations_are_about_the_axes_of_the_base():
    turn = np.array([0, 0, 0.3])
    start = np.array([0, 0, 0, np.pi, 0, 0])
    actions = np.zeros((1, 1, 7))
    actions[..., 3:6] = turn
    target, _ = decode("eef_delta", actions, start[None])
    expected = matrix_from_rotvec(turn) @ matrix_from_rotvec(start[3:])
    np.testing.assert_allclose(matrix_from_rotvec(target[0, 0, 3:]), expected, atol=1e-12)


def test_the_authors_differencing_subtracts_numbers():
    targets, gripper, start = trajectory("eef_delta", np.random.default_rng(1))
    actions = encode("eef_delta_componentwise", targets, gripper, start)
    expected = targets - np.concatenate([start[None], targets[:-1]])
    np.testing.assert_array_equal(actions[:, :6], expected)
    assert np.linalg.norm(actions[:, 3:6], axis=-1).max() > 3  # where a rotation vector flips


@pytest.mark.parametrize("space", SPACES)
def test_under_jit_as_in_numpy(space):
    targets, gripper, start = trajectory(space, np.random.default_rng(3))
    actions = encode(space, targets, gripper, start)[None]
    found, signs = jax.jit(decode, static_argnums=0)(space, actions, jnp.asarray(start[None]))
    expected, _ = decode(space, actions, start[None])
    rotations = [matrix_from_rotvec(np.asarray(x[..., 3:6], float)) for x in (found, expected)]
    if not is_joint(space):
        np.testing.assert_allclose(*rotations, atol=1e-5)
        found, expected = found[..., :3], expected[..., :3]
    np.testing.assert_allclose(found, expected, atol=1e-5)
    np.testing.assert_array_equal(signs[0], gripper)


def test_encode_leaves_its_input_alone():
    for space in SPACES:
        targets, gripper, start = trajectory(space, np.random.default_rng(2))
        before = targets.copy()
        encode(space, targets, gripper, start)
        np.testing.assert_array_equal(targets, before)


@pytest.mark.parametrize("space", ACTION_SPACES)
def test_collected_demonstrations_replay_in_every_space(space, lift, scene, renderer, demos):
    every = demos.episodes
    chunk = 16
    moves = []
    for demo in every:
        actions = demo_actions(demo, space, scene)
        rest = (
            np.zeros_like(actions) if space.endswith("delta") else np.tile(actions[-1:], (200, 1))
        )
        rest = np.resize(rest, (200, actions.shape[1]))
        rest[:, -1] = 1  # keep closed
        moves.append(np.concatenate([actions, rest])[: lift.horizon + chunk])
    moves = np.stack(moves)
    engine = NativeEngine(scene, controller_of(space), varied=lift.varied)
    start = starts(lift, scene, [d.seed for d in every])
    np.testing.assert_array_equal(start.qpos, [d.qpos[0] for d in every])
    count = len(every)
    episodes = Episodes(
        start,
        np.tile(intrinsics(45, renderer.height), (count, 1, 1, 1)),
        demos.header.world_from_camera[[d.cameras[:1] for d in every]],
    )
    agent = Agent(lambda obs, call: moves[:, call * chunk : (call + 1) * chunk], space)
    done = rollout(agent, lift, engine, renderer, episodes)
    assert done.success.all()
    assert done.ok.all()
