"""Actions as a camera sees them: rotations by another library, there and back, and policies."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxcam.errors import ConfigError
from jaxcam.models.action_frame import in_action_frame, seen_actions, seen_points
from jaxcam.models.conditioning import CameraConfig
from jaxcam.models.policy import Policy, PolicySpec
from jaxcam.rays import invert

RNG = np.random.default_rng(0)


def pose(*batch):
    made = np.tile(np.eye(4), (*batch, 1, 1))
    turns = Rotation.random(int(np.prod(batch)), random_state=1).as_matrix()
    made[..., :3, :3] = turns.reshape(*batch, 3, 3)
    made[..., :3, 3] = RNG.uniform(-1, 1, (*batch, 3))
    return made


def test_a_pose_and_a_move_are_what_the_camera_sees():
    camera, actions = pose(1)[0], RNG.normal(size=(5, 7))
    turn = camera[:3, :3]
    for absolute in (True, False):
        viewed = seen_actions(actions, invert(camera), absolute=absolute)
        rotation = Rotation.from_rotvec(actions[:, 3:6]).as_matrix()
        np.testing.assert_allclose(
            Rotation.from_rotvec(viewed[:, 3:6]).as_matrix(), turn.T @ rotation @ turn, atol=1e-12
        )
        ends = actions[:, :3] if absolute else actions[:, :3] + camera[:3, 3]
        ends = np.concatenate([ends, np.ones((5, 1))], -1) @ np.linalg.inv(camera).T
        np.testing.assert_allclose(viewed[:, :3], ends[:, :3], atol=1e-12)
        np.testing.assert_array_equal(viewed[:, 6], actions[:, 6])
    np.testing.assert_allclose(
        seen_points(actions[:, :3], invert(camera)),
        seen_actions(actions, invert(camera), absolute=True)[:, :3],
    )


@pytest.mark.parametrize("absolute", [True, False])
def test_there_and_back_is_exact(absolute):
    cameras, actions = invert(pose(4)), RNG.normal(size=(4, 6, 8))
    actions[0, :, 3:6] *= 5  # longer than half a turn, and not shortened by the way
    back = seen_actions(
        seen_actions(actions, cameras, absolute=absolute), invert(cameras), absolute=absolute
    )
    np.testing.assert_allclose(back, actions, atol=1e-12)


def echo(config, obs_steps=1, action_dim=7):
    """A policy whose action is a constant of its own frame, and whose loss tells its targets."""
    constant = jnp.arange(2 * action_dim, dtype=jnp.float32).reshape(2, action_dim) / 10

    def loss(params, batch, key):
        return params, {name: batch[name] for name in ("action", "keyframe") if name in batch}

    def act(params, obs, key):
        return jnp.broadcast_to(constant, (len(obs["proprio"]), *constant.shape))

    spec = PolicySpec(action_dim, 3, 2, 8, 8, 2, obs_steps)
    return Policy(lambda key: {}, loss, act, config, spec, 2), constant


@pytest.mark.parametrize("absolute", [True, False])
@pytest.mark.parametrize("obs_steps", [1, 3])
def test_policies_learn_and_act_in_the_frame_of_the_newest_first_view(absolute, obs_steps):
    base_from_world, cameras = pose(1)[0], pose(4, obs_steps, 2).astype(np.float32)
    config = CameraConfig(
        action_frame="camera",
        absolute_actions=absolute,
        base_from_actions=tuple(map(tuple, base_from_world.tolist())),
    )
    plain, constant = echo(config, obs_steps)
    policy = in_action_frame(plain)
    own = cameras[:, -1, 0]
    cameras = cameras[:, 0] if obs_steps == 1 else cameras
    obs = {"base_from_camera": cameras, "proprio": np.zeros((4, 3), np.float32)}
    actions = jax.jit(policy.act)({}, obs, None)
    camera_from_world = np.linalg.inv(own) @ base_from_world
    for i in range(4):
        turn, place = camera_from_world[i, :3, :3], camera_from_world[i, :3, 3]
        expected = constant[:, :3] @ turn - (place @ turn if absolute else 0)
        np.testing.assert_allclose(actions[i, :, :3], expected, atol=1e-5)
        np.testing.assert_allclose(actions[i, :, 3:6], constant[:, 3:6] @ turn, atol=1e-5)
    # What it is shown of its own actions is what it predicted; padded steps stay zeros.
    keyframe = RNG.normal(size=(4, 2, 3)).astype(np.float32)
    is_pad = np.array([[False, False]] * 3 + [[False, True]])
    batch = obs | {"action": actions, "keyframe": keyframe, "is_pad": is_pad}
    shown = jax.jit(policy.loss)(0.0, batch, None)[1]
    wanted = np.where(is_pad[..., None], 0, np.broadcast_to(constant, actions.shape))
    np.testing.assert_allclose(shown["action"], wanted, atol=1e-5)
    local = np.einsum("bij,btj->bti", np.linalg.inv(own)[:, :3, :3], keyframe - own[:, None, :3, 3])
    local[3, 1] = 0
    np.testing.assert_allclose(shown["keyframe"], local, atol=1e-5)


def test_the_robots_own_frame_leaves_a_policy_as_it_is():
    plain, _ = echo(CameraConfig())
    assert in_action_frame(plain) is plain


def test_actions_without_a_pose_are_refused():
    plain, _ = echo(replace(CameraConfig(), action_frame="camera"), action_dim=5)
    with pytest.raises(ConfigError, match="these have 5"):
        in_action_frame(plain)
