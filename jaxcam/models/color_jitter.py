"""Random colours of pictures in training, so that a policy does not learn its scenes by theirs.

The four moves of torchvision's `ColorJitter` (brightness, contrast, saturation, hue), which the
authors' code offers beside its crops. Each is linear in a pixel's colours: together they are one
matrix and one offset a picture.
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxcam.models.policy import Batch

HUE = 0.25
"""Largest turn of the hue, as a share of a whole turn, at strength 1: the authors' 0.1 beside
0.4 of the others."""
_GREY = np.array([0.299, 0.587, 0.114], np.float32)
"""Shares of red, green and blue in a pixel's brightness (ITU-R BT.601)."""
_YIQ = np.array([_GREY, [0.596, -0.274, -0.322], [0.211, -0.523, 0.312]], np.float32)
"""From colours to brightness and the two axes that hues turn in (NTSC)."""


def color_jitter(batch: Batch, key: jax.Array, *, strength: float) -> Batch:
    """Changes the colours of every picture, each in its own way.

    Args:
        batch: With `image` [..., H, W, 3], 0 to 255.
        key: What every picture draws its factors from.
        strength: Brightness, contrast and saturation are multiplied by 1 - strength to
            1 + strength, and hues turn by up to `HUE` of it. 0 leaves the batch as it is.

    Returns:
        The batch with float32 pictures, clipped to 0 to 255. Cameras stay where they are.
    """
    if not strength:
        return batch
    image = jnp.asarray(batch["image"], jnp.float32)
    drawn = jax.random.uniform(key, (*image.shape[:-3], 4), minval=-strength, maxval=strength)
    brightness, contrast, saturation = (1 + drawn[..., i, None, None] for i in range(3))
    matrix = brightness * contrast * _hue_turn(2 * np.pi * HUE * drawn[..., 3])
    # Saturation moves colours to and from their grey, contrast to and from the picture's mean grey.
    matrix = saturation * matrix + (1 - saturation) * _grey_of(matrix)
    mean = (brightness[..., 0] * (image.mean((-3, -2)) @ _GREY)[..., None])[..., None, None]
    # Sums that fuse: XLA's product of a matrix this small takes a CPU many times as long.
    mixed = [sum(image[..., c] * matrix[..., d, c, None, None] for c in range(3)) for d in range(3)]
    changed = jnp.stack(mixed, -1) + (1 - contrast[..., None]) * mean
    return {**batch, "image": jnp.clip(changed, 0, 255)}


def _hue_turn(angle: jax.Array) -> jax.Array:
    """The matrices [..., 3, 3] that turn hues by angles (rad) [...] and keep brightness."""
    cos, sin, one, zero = jnp.cos(angle), jnp.sin(angle), jnp.ones_like(angle), 0 * angle
    rows = [[one, zero, zero], [zero, cos, -sin], [zero, sin, cos]]
    turn = jnp.stack([jnp.stack(row, -1) for row in rows], -2)
    return jnp.asarray(np.linalg.inv(_YIQ)) @ turn @ _YIQ


def _grey_of(matrix: jax.Array) -> jax.Array:
    """The matrices [..., 3, 3] that give the grey of what others give."""
    return jnp.broadcast_to((_GREY @ matrix)[..., None, :], matrix.shape)
