"""Crops of image and camera together.

This is the only door through which pixels change places, and it moves K with them, so a ray-map
computed afterwards belongs to the picture that the policy sees (paper, section V-A3).
"""

import jax
import jax.numpy as jnp

from jaxcam.models.policy import Batch


def random_crop(batch: Batch, key: jax.Array, *, smallest: float) -> Batch:
    """Crops a random square of every picture and resizes it back, K moving along.

    Args:
        batch: With `image` [..., H, W, 3] and `K` [..., 3, 3].
        key: Every picture draws its own side and corner from it.
        smallest: Least side of the square as a share of the picture; the side is uniform in
            [smallest, 1]. 1 leaves the batch as it is.

    Returns:
        The batch with float32 pictures (0 to 255, nearest pixel, as the authors resize) and new K.
    """
    if smallest >= 1:
        return batch
    image, K = batch["image"], batch["K"]
    *lead, height, width, _ = image.shape
    side_key, corner_key = jax.random.split(key)
    scale = jax.random.uniform(side_key, lead, minval=smallest, maxval=1.0)
    corner = jax.random.uniform(corner_key, (*lead, 2))
    size = jnp.array([height, width], jnp.float32)
    # Whole pixels, so that the nearest pixel is the exact sample and K exact too.
    side = jnp.round(scale[..., None] * size)
    corner = jnp.floor(corner * (size - side + 1))
    crop = jnp.vectorize(_crop, signature="(h,w,c),(k),(k)->(h,w,c)")
    cropped = crop(image, corner, side)
    zoom = size / side
    # x' = (x - left) * zoom for image coordinates, whose corner is (0, 0).
    shift = jnp.zeros_like(K).at[..., 0, 2].set(corner[..., 1]).at[..., 1, 2].set(corner[..., 0])
    factor = jnp.stack([zoom[..., 1], zoom[..., 0], jnp.ones(lead)], -1)[..., None]
    return {**batch, "image": cropped, "K": (K - shift) * factor}


def window(batch: Batch, side: int, key: jax.Array | None) -> Batch:
    """Cuts a square out of every picture, K moving along.

    Args:
        batch: With `image` [..., H, W, 3] and `K` [..., 3, 3].
        side: Side of the square in pixels.
        key: Every picture draws its own corner from it; without it the middle is cut out.

    Returns:
        `image` and `K` alone.
    """
    image, K = batch["image"], batch["K"]
    *lead, height, width, _ = image.shape
    room = jnp.array([height - side, width - side])
    corner = jnp.broadcast_to(jnp.round(room / 2), (*lead, 2))
    if key is not None:
        corner = jnp.floor(jax.random.uniform(key, (*lead, 2)) * (room + 1))

    def cut(image: jax.Array, corner: jax.Array) -> jax.Array:
        start = (corner[0], corner[1], 0)
        return jax.lax.dynamic_slice(image, start, (side, side, image.shape[-1]))

    cut_all = jnp.vectorize(cut, signature="(h,w,c),(k)->(s,s,c)")
    shift = jnp.zeros_like(K).at[..., 0, 2].set(corner[..., 1]).at[..., 1, 2].set(corner[..., 0])
    return {"image": cut_all(image, corner.astype(jnp.int32)), "K": K - shift}


def _crop(image: jax.Array, corner: jax.Array, side: jax.Array) -> jax.Array:
    """One picture [H, W, 3]: the square's pixel nearest to each pixel of the result."""
    rows, columns = (
        jnp.floor(corner[a] + (jnp.arange(image.shape[a]) + 0.5) * side[a] / image.shape[a]).astype(
            jnp.int32
        )
        for a in (0, 1)
    )
    return image[rows][:, columns]
