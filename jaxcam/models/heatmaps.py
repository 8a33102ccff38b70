"""Heat maps that are told where to lie: on where the gripper will next close, or next open.

A loss on actions finds what is small late or never: the handle of Square's nut is three pixels
wide. So the first two heat maps of every view may be trained by cross-entropy, as keypoint
detectors are: with the cells around where the demonstration's own keyframe appears in the picture,
the first map while the gripper is open, the second while it is closed.
"""

import jax
import jax.numpy as jnp

from jaxcam.models.policy import Batch, keyframe_padding
from jaxcam.rays import Camera

TAUGHT = 2
"""Heat maps that are taught."""
_WHOLE = 0.99
"""Share of a target that must lie on the grid; the rest is beyond the picture's edge."""


def heatmap_loss(logits: jax.Array, batch: Batch) -> jax.Array:
    """Cross-entropy of the taught heat maps with where keyframes are seen.

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
    taught = ~keyframe_padding(batch)[:, :1] & (depth > 0) & (target.sum((-2, -1)) > _WHOLE)
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
