"""Actions in the frame of the camera: a rival of rays that tells a policy nothing.

As in OC-VLA (arXiv 2508.13103) the policy predicts how the grip moves as the camera sees it, and
the camera's pose turns that into the robot's actions afterwards. The camera is the first view's, at
the newest observation; all steps of a chunk are in its frame.

The first three numbers of an action are a position or a move (metres), the next three a rotation
vector with axes of the same frame; the others, such as the gripper's, stay as they are. Both
vectors turn with the camera, and positions are counted from it. A rotation vector is the same
rotation said with other axes, whatever it is counted from: there and back is exact, and what does
not jump in one frame does not in the other.

What the robot feels stays as it is reported, in its own frame: joint angles have no frame to change
to, and a grip pose in both frames would tell the policy the camera.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from jaxcam.errors import ConfigError
from jaxcam.models.conditioning import CameraConfig
from jaxcam.models.policy import Batch, Key, Obs, Params, Policy
from jaxcam.rays import invert
from jaxcam.rays.rotations import Array, array_namespace, matmul


def seen_points(points: Array, camera_from_points: Array) -> Array:
    """Points [..., T, 3] as a camera sees them, metres.

    Args:
        points: In some frame.
        camera_from_points: From that frame [..., 4, 4].
    """
    return _turned(points, camera_from_points) + camera_from_points[..., None, :3, 3]


def seen_actions(actions: Array, camera_from_actions: Array, *, absolute: bool) -> Array:
    """Actions [..., T, A] as a camera sees them; those of a camera in another frame by the inverse.

    Args:
        actions: A is at least 6.
        camera_from_actions: From the frame that they are in [..., 4, 4].
        absolute: Whether they are grip poses rather than what these move by.
    """
    xp = array_namespace(actions, camera_from_actions)
    viewed = seen_points if absolute else _turned
    turned = _turned(actions[..., 3:6], camera_from_actions)
    others = actions[..., 6:]
    others = xp.broadcast_to(others, (*turned.shape[:-1], others.shape[-1]))
    return xp.concatenate([viewed(actions[..., :3], camera_from_actions), turned, others], -1)


def in_action_frame(policy: Policy) -> Policy:
    """The policy with losses and actions in the frame of its settings' `action_frame`.

    Batches and actions of the policy that comes back are in the run's own frame, as all others'.
    The statistics that it was made with are of actions and keyframes as the cameras see them.

    Args:
        policy: What predicts actions, and keyframes, in that frame.

    Raises:
        ConfigError: Actions have no pose.
    """
    config: CameraConfig = policy.config
    if getattr(config, "action_frame", "base") == "base":  # not every family knows of frames
        return policy
    if policy.spec.action_dim < 6:
        raise ConfigError(
            "action_frame camera: actions begin with a position and a rotation vector, six "
            f"numbers; these have {policy.spec.action_dim}."
        )
    base_from_actions = np.array(config.base_from_actions, np.float32)
    absolute = config.absolute_actions

    def camera_from_base(obs: Obs) -> jax.Array:
        """Of the first view [B, 4, 4]."""
        poses = jnp.asarray(obs["base_from_camera"], jnp.float32)
        return invert(poses[:, 0] if policy.spec.obs_steps == 1 else poses[:, -1, 0])

    def loss(params: Params, batch: Batch, key: Key) -> tuple[jax.Array, dict[str, jax.Array]]:
        pose = camera_from_base(batch)
        from_actions = matmul(pose, base_from_actions)
        targets = {"action": seen_actions(batch["action"], from_actions, absolute=absolute)}
        if "keyframe" in batch:
            targets["keyframe"] = seen_points(batch["keyframe"], pose)
        is_pad = batch["is_pad"][..., None]
        targets = {name: jnp.where(is_pad, 0, values) for name, values in targets.items()}
        return policy.loss(params, {**batch, **targets}, key)

    def act(params: Params, obs: Obs, key: Key) -> jax.Array:
        actions_from_camera = invert(matmul(camera_from_base(obs), base_from_actions))
        return seen_actions(policy.act(params, obs, key), actions_from_camera, absolute=absolute)

    return replace(policy, loss=loss, act=act)


def _turned(vectors: Array, camera_from_vectors: Array) -> Array:
    xp = array_namespace(vectors, camera_from_vectors)
    return matmul(vectors, xp.swapaxes(camera_from_vectors[..., :3, :3], -1, -2))
