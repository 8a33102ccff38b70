"""Keypoints: heat maps over features, what they pool of image and rays, and how two are taught."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from jaxcam.models.conditioning import TABLE_MIDDLE, VisionConfig
from jaxcam.models.layers import linear
from jaxcam.models.policy import Batch, keyframe_padding
from jaxcam.rays import Camera

FLATTEST = 0.1
"""A line less steep than this (z part of its unit direction) is not followed to a height."""
TAUGHT = 2
"""Heat maps of a view that may be taught, the first ones: see `heatmap_loss`."""
WHOLE = 0.99
"""Share of such a map's target that must lie on the grid; the rest is beyond the picture's edge."""


class Keypoints(NamedTuple):
    """What heat maps pool, each [N, k, ...]."""

    pixel: jax.Array
    """Expected position in the image, (x, y) in -1..1."""
    ray: jax.Array
    """Expected ray (d, m)."""
    features: jax.Array
    """Expected feature vector."""


def pool_keypoints(
    logits: jax.Array, rays: jax.Array, features: jax.Array, *, corners: bool = False
) -> Keypoints:
    """Expectations under spatial softmaxes.

    Args:
        logits: Heat maps before the softmax, float32 [N, h, w, k].
        rays: Ray-map on the same grid, [N, h, w, 6].
        features: Feature map, [N, h, w, C].
        corners: Whether positions of -1 and 1 are the middles of the outermost cells, as in
            Diffusion Policy, instead of the image's edges.

    Returns:
        Positions, rays and features. All rays of a camera meet in its centre, so an expected (d, m)
        is again a line through it, with a direction shorter than 1.
    """
    n, h, w, k = logits.shape
    weights = jax.nn.softmax(logits.reshape(n, h * w, k), axis=1)
    x, y = (2 * np.arange(size, dtype=np.float32) + 1 for size in (w, h))
    x, y = x / w - 1, y / h - 1
    if corners:
        x, y = (np.linspace(-1, 1, size, dtype=np.float32) for size in (w, h))
    pixel = np.stack(np.meshgrid(x, y), -1).reshape(h * w, 2)
    geometry = jnp.concatenate(
        [jnp.broadcast_to(pixel, (n, h * w, 2)), rays.reshape(n, h * w, 6)], -1
    )
    geometry = jnp.einsum("npk,npc->nkc", weights, geometry, precision="highest")
    features = features.reshape(n, h * w, -1)
    pooled = jnp.einsum("npk,npc->nkc", weights.astype(features.dtype), features)
    return Keypoints(geometry[..., :2], geometry[..., 2:], pooled)


def lift_to_height(ray: jax.Array, height: jax.Array) -> jax.Array:
    """The point of each line at a height.

    Args:
        ray: Lines (d, m), [..., 6]; d need not have length 1.
        height: Wanted z of the point, [...].

    Returns:
        Points [..., 3]. They always lie on their line; lines flatter than `FLATTEST` fall short of
        the height instead of running off to infinity.
    """
    d, m = ray[..., :3], ray[..., 3:]
    norm2 = jnp.sum(d * d, -1, keepdims=True)
    foot = jnp.cross(d, m) / norm2  # The line's nearest point to the origin.
    dz2 = jnp.maximum(d[..., 2] ** 2, FLATTEST**2 * norm2[..., 0])
    along = (height - foot[..., 2]) * d[..., 2] / dz2
    return foot + along[..., None] * d


def heatmap_loss(logits: jax.Array, batch: Batch) -> jax.Array:
    """Cross-entropy of the taught heat maps with where keyframes are seen.

    A loss on actions finds what is small late or never: the handle of Square's nut is three pixels
    wide. So two heat maps of every view may be taught as those of keypoint detectors are: to lie
    where the demonstration's own keyframe appears in the picture, the first one while the gripper
    is open, the second while it is closed.

    Args:
        logits: Of every view's heat maps before the softmax [B*V, h, w, k].
        batch: With cameras, keyframes in the same frame as these, and actions whose last number
            closes the gripper where it is positive. Only the first step of a chunk counts.

    Returns:
        A scalar (nats), the mean over views whose picture has the keyframe in it, half a cell or
        more from the edge.
    """
    batch_size, views = batch["K"].shape[:2]
    height, width = batch["image"].shape[2:4]
    h, w = logits.shape[1:3]
    cameras = Camera(
        batch["K"], batch["base_from_camera"], height, width, distortion=batch.get("distortion")
    )
    pixel, depth = cameras.project(batch["keyframe"][:, :1])
    target = _share(pixel[..., 1] * h / height, h)[..., :, None]
    target = target * _share(pixel[..., 0] * w / width, w)[..., None, :]
    taught = ~keyframe_padding(batch)[:, :1] & (depth > 0) & (target.sum((-2, -1)) > WHOLE)
    closed = batch["action"][:, :1, None, None, -1] > 0
    heat = logits.reshape(batch_size, views, h, w, -1)
    heat = jnp.where(closed, heat[..., 1], heat[..., 0])
    log_share = jax.nn.log_softmax(heat.reshape(batch_size, views, -1), -1).reshape(heat.shape)
    entropy = -jnp.where(taught[..., None, None], target * log_share, 0).sum((-2, -1))
    return entropy.sum() / jnp.maximum(taught.sum(), 1)


def _share(place: jax.Array, size: int) -> jax.Array:
    """What each of `size` cells gets of a point at `place` [...], in cells from the edge: linear.

    So the expected cell under the target is where the point is, which is what is pooled.
    """
    return jnp.clip(1 - abs(place[..., None] - 0.5 - jnp.arange(size)), 0)


class KeypointPool(nnx.Module):
    """Heat maps over a feature map, and what they pool, as one vector a keypoint."""

    def __init__(self, config: VisionConfig, *, rngs: nnx.Rngs):
        channels = config.encoder_width
        self.heat = linear(channels, config.keypoints, rngs=rngs, dtype=config.dtype)
        self.heat_gain = config.heat_gain
        self.with_rays = config.network == "keypoints"
        self.with_lift = self.with_rays and config.lift
        self.lift_unit = config.lift_unit
        self.corners = config.pool == "softmax"
        plain = not self.with_rays and not self.corners
        self.with_features = config.keypoint_features or plain
        if self.with_lift:
            self.height = linear(channels, 1, rngs=rngs, dtype=jnp.float32)
            self.height_bias = nnx.Param(jnp.zeros(config.keypoints))
        self.width = 2 + 6 * self.with_rays + 3 * self.with_lift + channels * self.with_features

    def __call__(self, features: jax.Array, rays: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Keypoints [N, k, width] and their heat maps before the softmax [N, h, w, k], float32.

        Args:
            features: Feature maps [N, h, w, C].
            rays: Ray-maps [N, h, w, 6].
        """
        logits = self.heat(features).astype(jnp.float32) * self.heat_gain
        points = pool_keypoints(logits, rays, features, corners=self.corners)
        parts = [points.pixel]
        if self.with_rays:
            parts.append(points.ray)
        if self.with_lift:
            height = self.height(points.features)[..., 0] + self.height_bias
            lifted = lift_to_height(points.ray, height)
            if self.lift_unit:
                lifted = (lifted - np.array(TABLE_MIDDLE, np.float32)) / self.lift_unit
            parts.append(lifted)
        if self.with_features:
            parts.append(points.features.astype(jnp.float32))
        return jnp.concatenate(parts, -1), logits
