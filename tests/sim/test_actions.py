"""Four action spaces: there and back, chunk by chunk, and executed in the simulator."""

from typing import get_args

import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxcam.config.names import ActionSpace
from jaxcam.data.batches import demo_actions
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.rays.rotations import matrix_from_rotvec, rotvec_from_matrix
from jaxcam.sim import make_task
from jaxcam.sim.actions import (
    ACTION_SPACES,
    action_dim,
    are_numbers,
    controller_of,
    decode,
    encode,
    is_absolute,
    is_joint,
    space_of,
)
from jaxcam.sim.mujoco.native import NativeEngine
from jaxcam.sim.rollout import Agent, Episodes, rollout
from jaxcam.sim.task import starts

LENGTH = 24
SPACES = (*get_args(ActionSpace), "eef_abs_world")
NOMINAL = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])


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


def assert_same_targets(space, computed, expected):
    if is_joint(space):
        np.testing.assert_allclose(computed, expected, atol=1e-12)
        return
    np.testing.assert_allclose(computed[..., :3], expected[..., :3], atol=1e-12)
    # As matrices: at half a turn two rotation vectors name one rotation.
    rotations = (matrix_from_rotvec(x[..., 3:]) for x in (computed, expected))
    np.testing.assert_allclose(*rotations, atol=1e-7)


@pytest.mark.parametrize("space", SPACES)
def test_there_and_back_at_once_and_chunk_by_chunk(space):
    rng = np.random.default_rng(0)
    batch = [trajectory(space, rng) for _ in range(3)]
    targets, signs, start = (np.stack(x) for x in zip(*batch, strict=True))
    actions = np.stack([encode(space, *each, NOMINAL) for each in batch])
    assert actions.shape == (3, LENGTH, action_dim(space))
    whole, gripper = decode(space, actions, start, NOMINAL)
    assert_same_targets(space, whole, targets)
    np.testing.assert_array_equal(gripper, signs)
    anchor, parts = start, []
    for first, last in ((0, 1), (1, 9), (9, LENGTH)):
        part, _ = decode(space, actions[:, first:last], anchor, NOMINAL)
        parts.append(part)
        anchor = part[:, -1]
    assert_same_targets(space, np.concatenate(parts, 1), whole)


def test_small_moves_give_small_deltas_across_half_a_turn():
    targets, gripper, start = trajectory("eef_delta", np.random.default_rng(1))
    actions = encode("eef_delta", targets, gripper, start, NOMINAL)
    jumps = np.linalg.norm(np.diff(targets[:, 3:], axis=0), axis=-1)
    assert jumps.max() > 3  # the vectors themselves flip their sign
    assert np.linalg.norm(actions[:, 3:6], axis=-1).max() < 1


def turning(yaw, tilt):
    """Targets [T, 6] of a grip that points down, turned about the world's z and tilted."""
    down = Rotation.from_euler("zx", np.stack([yaw, tilt], -1)) * Rotation.from_matrix(NOMINAL)
    return np.concatenate([np.zeros((len(yaw), 3)), down.as_rotvec()], -1)


def longest(vectors):
    return np.linalg.norm(vectors, axis=-1).max()


@hypothesis.given(
    start=st.floats(-2, 2),
    speed=st.floats(-0.06, 0.06),
    tilt=st.floats(-0.3, 0.3),
    shake=st.integers(0, 2**16),
)
def test_absolute_rotations_move_as_steadily_as_the_grip(start, speed, tilt, shake):
    """Near half a turn from the world's axes, and past half a turn from the nominal grip."""
    noise = 0.01 * np.random.default_rng(shake).normal(size=(2, 40))
    targets = turning(start + speed * np.arange(40) + noise[0], tilt + noise[1])
    gripper = np.ones(40)
    actions = encode("eef_abs", targets, gripper, targets[0], NOMINAL)
    poses = Rotation.from_rotvec(targets[:, 3:])
    turned = (poses[1:] * poses[:-1].inv()).magnitude()
    assert longest(np.diff(actions[:, 3:6], axis=0)) < 5 * turned.max() + 1e-6
    decoded, _ = decode("eef_abs", actions.astype(np.float32)[None], targets[:1], NOMINAL)
    apart = Rotation.from_rotvec(decoded[0, :, 3:]) * poses.inv()
    assert apart.magnitude().max() < 2e-6
    np.testing.assert_array_equal(decoded[0, :, :3], 0)


def test_a_grip_that_points_down_has_small_numbers():
    yaw = np.linspace(-1.5, 1.5, 50)
    targets = turning(yaw, 0.1 * np.sin(9 * yaw))
    numbers = {
        space: encode(space, targets, np.ones(50), targets[0], NOMINAL)[:, 3:6]
        for space in ("eef_abs", "eef_abs_world")
    }
    assert longest(np.diff(numbers["eef_abs_world"], axis=0)) > 6  # a jump of a turn
    assert longest(np.diff(numbers["eef_abs"], axis=0)) < 0.15
    assert longest(numbers["eef_abs"]) < 1.6
    mean = Rotation.from_rotvec(numbers["eef_abs"].mean(0))
    apart = Rotation.from_rotvec(numbers["eef_abs"]) * mean.inv()
    assert apart.magnitude().max() < 1.6


@pytest.mark.parametrize("task", ["lift", "push", "roll_ball"])
def test_the_nominal_grip_points_down_in_every_world(task):
    world = make_task(task).scene("randomized")
    np.testing.assert_allclose(world.nominal_grip[:, 2], [0, 0, -1], atol=1e-12)
    assert np.linalg.det(world.nominal_grip) == pytest.approx(1)


def test_the_nominal_grip_is_that_at_home(lift, scene, demos):
    """So that rotations are small at the start, and all yaws within half a turn equally far."""
    first = np.stack([demo.world_from_grip()[0, :3, :3] for demo in demos.episodes])
    apart = Rotation.from_matrix(first) * Rotation.from_matrix(scene.nominal_grip).inv()
    assert apart.magnitude().max() < 0.3


def test_demonstrations_have_no_jumps(demos, scene):
    for demo in demos.episodes:
        actions = demo_actions(demo, "eef_abs", scene)
        assert longest(np.diff(actions[:, 3:6], axis=0)) < 0.5
        assert longest(actions[:, 3:6]) < np.pi


def test_a_runs_settings_name_its_space():
    assert space_of("eef_abs", "nominal") == "eef_abs"
    assert space_of("eef_abs", "world") == "eef_abs_world"
    assert space_of("joint_abs", "nominal") == "joint_abs"
    absolute = {space for space in SPACES if is_absolute(space)}
    assert absolute == {"eef_abs", "eef_abs_world", "joint_abs"}


def test_delta_rotations_are_about_the_axes_of_the_base():
    turn = np.array([0, 0, 0.3])
    start = np.array([0, 0, 0, np.pi, 0, 0])
    actions = np.zeros((1, 1, 7))
    actions[..., 3:6] = turn
    target, _ = decode("eef_delta", actions, start[None], NOMINAL)
    expected = matrix_from_rotvec(turn) @ matrix_from_rotvec(start[3:])
    np.testing.assert_allclose(matrix_from_rotvec(target[0, 0, 3:]), expected, atol=1e-12)


def test_the_authors_differencing_subtracts_numbers():
    targets, gripper, start = trajectory("eef_delta", np.random.default_rng(1))
    actions = encode("eef_delta_componentwise", targets, gripper, start, NOMINAL)
    expected = targets - np.concatenate([start[None], targets[:-1]])
    np.testing.assert_array_equal(actions[:, :6], expected)
    assert np.linalg.norm(actions[:, 3:6], axis=-1).max() > 3  # where a rotation vector flips


@pytest.mark.parametrize("space", SPACES)
def test_under_jit_as_in_numpy(space):
    targets, gripper, start = trajectory(space, np.random.default_rng(3))
    actions = encode(space, targets, gripper, start, NOMINAL)[None]
    anchor = jnp.asarray(start[None])
    decoded, signs = jax.jit(decode, static_argnums=0)(space, actions, anchor, NOMINAL)
    expected, _ = decode(space, actions, start[None], NOMINAL)
    rotations = [matrix_from_rotvec(np.asarray(x[..., 3:6], float)) for x in (decoded, expected)]
    if not is_joint(space):
        np.testing.assert_allclose(*rotations, atol=1e-5)
        decoded, expected = decoded[..., :3], expected[..., :3]
    np.testing.assert_allclose(decoded, expected, atol=1e-5)
    np.testing.assert_array_equal(signs[0], gripper)


def test_encode_leaves_its_input_alone():
    for space in SPACES:
        targets, gripper, start = trajectory(space, np.random.default_rng(2))
        before = targets.copy()
        encode(space, targets, gripper, start, NOMINAL)
        np.testing.assert_array_equal(targets, before)


@pytest.mark.parametrize("space", ACTION_SPACES)
def test_collected_demonstrations_replay_in_every_space(space, lift, scene, renderer, demos):
    episodes = demos.episodes
    chunk = 16
    moves = []
    for demo in episodes:
        actions = demo_actions(demo, space, scene)
        rest = (
            np.zeros_like(actions) if space.endswith("delta") else np.tile(actions[-1:], (200, 1))
        )
        rest = np.resize(rest, (200, actions.shape[1]))
        rest[:, -1] = 1  # keep closed
        moves.append(np.concatenate([actions, rest])[: lift.horizon + chunk])
    moves = np.stack(moves)
    engine = NativeEngine(scene, controller_of(space), varied=lift.varied)
    start = starts(lift, scene, [d.seed for d in episodes])
    np.testing.assert_array_equal(start.qpos, [d.qpos[0] for d in episodes])
    count = len(episodes)
    episodes = Episodes(
        start,
        np.tile(intrinsics(45, renderer.height), (count, 1, 1, 1)),
        demos.header.world_from_camera[[d.cameras[:1] for d in episodes]],
    )
    agent = Agent(lambda obs, call, active: moves[:, call * chunk : (call + 1) * chunk], space)
    done = rollout(agent, lift, engine, renderer, episodes)
    assert done.success.all()
    assert done.ok.all()


def test_which_actions_can_be_executed():
    chunks = np.zeros((4, 2, 7))
    chunks[1, 0, 3], chunks[2, 1, 6], chunks[3, 0, 0] = np.nan, -np.inf, 1e7
    assert are_numbers(chunks).tolist() == [True, False, False, False]
    assert are_numbers(jnp.asarray(chunks)).tolist() == [True, False, False, False]
