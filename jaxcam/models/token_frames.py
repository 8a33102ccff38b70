"""Attention between tokens that stand in frames: PRoPE, GTA and rotary embeddings of rays.

Every token i of a picture has an invertible matrix D_i, block by block along a head's channels.
Attention from i to j is computed with the query D_i^T q_i, the key D_j^-1 k_j and the value
D_j^-1 v_j, and what comes of it is multiplied by D_i. So i's score of j and what it reads of it
depend on D_i D_j^-1 alone, how j's camera stands to i's; a common motion of all cameras, of the
right side of all D, changes nothing. Half of the channels are the camera's:

- ``prope`` (Cameras as Relative Positional Encoding, arXiv 2507.10496): D is the projection
  ``lift(K) camera_from_base``, 4 × 4, repeated; K in shares of the picture, its middle at 0.
- ``gta`` (Geometric Transform Attention, arXiv 2310.10375): D is ``camera_from_base``, without K.
- ``ray_rope``: D rotates pairs of channels by multiples of the azimuth and of the elevation, in the
  base frame, of the ray through the token's middle. Rays know how a camera is turned, its K and
  its lens, not where it stands; straight up and down they have no azimuth.

The others rotate pairs of channels by the token's column and row, as in PRoPE's own code, so that
tokens of one picture can be told apart; networks with rotary positions of their own keep those in
their place. Lenses bend the rays of ray_rope alone.

**Tokens without a camera** (action queries, state, words) stand in the robot's base: D is 1. That
is what makes relative encodings say anything at all where there is one view. All of its tokens
share one camera, D_i D_j^-1 is the same wherever that camera stands, and a policy could not know
it. From an action query to an image token the relative transform is the camera's pose in the base
itself, so what actions read of the picture is read in the frame in which they act.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

LONGEST = 100.0
"""Longest wavelength of the rotations by columns and rows over 2 pi, in tokens, as in PRoPE's."""


class TokenFrames(NamedTuple):
    """The frames of a sequence's first tokens, those of V views; the others are the base's.

    Half of a head's channels are moved by `projection`, where there is one, four at a time; the
    next are rotated by `angles`, and those that remain left alone.
    """

    count: int
    """Tokens of all views together, those of a view one after the other."""
    projection: tuple[jax.Array, jax.Array] | None = None
    """Picture from base and its inverse, [B, V, 4, 4] each."""
    angles: jax.Array | None = None
    """Radians [B or 1, count, 1, blocks, F]: in each block of 2 F channels the first F are rotated
    against the others."""

    def query(self, x: jax.Array) -> jax.Array:
        """Queries [B, tokens, heads, channels] as those of the base."""
        return self._moved(x, self.projection and self.projection[0].mT)

    def read(self, x: jax.Array) -> jax.Array:
        """Keys or values [B, tokens, heads, channels] as those of the base."""
        return self._moved(x, self.projection and self.projection[1])

    def output(self, x: jax.Array) -> jax.Array:
        """What queries have read [B, tokens, heads, channels], in their own frames again."""
        return self._moved(x, self.projection and self.projection[0], back=True)

    def _moved(self, x: jax.Array, matrix: jax.Array | None, *, back: bool = False) -> jax.Array:
        """Tokens after a move of those that have a camera; computed in float32."""
        own, parts, done = x[:, : self.count].astype(jnp.float32), [], 0
        if matrix is not None:
            done = own.shape[-1] // 2
            parts.append(_multiplied(own[..., :done], matrix))
        if self.angles is not None:
            first, done = done, done + 2 * self.angles[0, 0].size
            parts.append(_rotated(own[..., first:done], self.angles, back))
        own = jnp.concatenate([*parts, own[..., done:]], -1).astype(x.dtype)
        return jnp.concatenate([own, x[:, self.count :]], 1)


def camera_projections(
    K: jax.Array | None, base_from_camera: jax.Array, height: int, width: int
) -> tuple[jax.Array, jax.Array]:
    """Picture from base, and its inverse.

    Args:
        K: Intrinsics in pixels of the picture [..., 3, 3]; None leaves the camera's frame.
        base_from_camera: Poses [..., 4, 4].
        height: Rows of the picture.
        width: Its columns.

    Returns:
        ``lift(K) camera_from_base`` and ``base_from_camera lift(K)^-1`` [..., 4, 4], with K in
        shares of the picture's sides and its middle at 0.
    """
    turn, place = base_from_camera[..., :3, :3], base_from_camera[..., :3, 3:]
    last = jnp.broadcast_to(jnp.array([[0.0, 0.0, 0.0, 1.0]]), (*turn.shape[:-2], 1, 4))
    into = jnp.concatenate([turn.mT, -_product(turn.mT, place)], -1)
    back = turn
    if K is not None:
        shares = np.array([[1 / width, 0, -0.5], [0, 1 / height, -0.5], [0, 0, 1]], np.float32)
        K = _product(jnp.asarray(shares), K)
        into, back = _product(K, into), _product(turn, _triangular_inverse(K))
    back = jnp.concatenate([back, place], -1)
    return jnp.concatenate([into, last], -2), jnp.concatenate([back, last], -2)


def cell_angles(rows: int, columns: int, pairs: int) -> np.ndarray:
    """Angles of a picture's tokens by their column, then by their row.

    Args:
        rows: Of tokens.
        columns: Likewise.
        pairs: Of channels, for each of the two.

    Returns:
        Radians [rows * columns, 2 * pairs], tokens row by row; the longest wavelength is `LONGEST`.
    """
    rates = LONGEST ** (-np.arange(pairs) / pairs)
    row, column = (x.reshape(-1, 1) for x in np.mgrid[:rows, :columns])
    return np.concatenate([column * rates, row * rates], -1).astype(np.float32)


def ray_angles(rays: jax.Array, pairs: int) -> jax.Array:
    """Angles of tokens by the azimuth, then by the elevation of their rays.

    Args:
        rays: With the direction first, unit or not [..., 6].
        pairs: Of channels, for each of the two: multiples 1 to `pairs`, so that a whole turn of the
            azimuth is none.

    Returns:
        Radians [..., 2 * pairs].
    """
    x, y, z = (rays[..., i] for i in range(3))
    azimuth, elevation = jnp.arctan2(y, x), jnp.arctan2(z, jnp.hypot(x, y))
    multiples = np.arange(1, pairs + 1, dtype=np.float32)
    return jnp.concatenate([azimuth[..., None] * multiples, elevation[..., None] * multiples], -1)


def _triangular_inverse(K: jax.Array) -> jax.Array:
    """Of upper triangular matrices [..., 3, 3] that end in 1."""
    fx, skew, cx = K[..., 0, 0], K[..., 0, 1], K[..., 0, 2]
    fy, cy = K[..., 1, 1], K[..., 1, 2]
    zero, one = jnp.zeros_like(fx), jnp.ones_like(fx)
    rows = (
        (1 / fx, -skew / (fx * fy), (skew * cy / fy - cx) / fx),
        (zero, 1 / fy, -cy / fy),
        (zero, zero, one),
    )
    return jnp.stack([jnp.stack(row, -1) for row in rows], -2)


def _product(a: jax.Array, b: jax.Array) -> jax.Array:
    return jnp.matmul(a, b, precision="highest")


def _multiplied(x: jax.Array, matrix: jax.Array) -> jax.Array:
    """Channels [B, V * N, heads, 4 c] times matrices [B, V, 4, 4], four at a time."""
    batch, views = matrix.shape[:2]
    y = jnp.matmul(x.reshape(batch, views, -1, 4), matrix.mT, precision="highest")
    return y.reshape(x.shape)


def _rotated(x: jax.Array, angles: jax.Array, back: bool) -> jax.Array:
    """Channels [B, T, heads, 2 F blocks] rotated by minus their angles, or back."""
    sin, cos = jnp.sin(angles), jnp.cos(angles)
    sin = -sin if back else sin
    pairs = x.reshape(*x.shape[:-1], angles.shape[-2], 2, angles.shape[-1])
    a, b = pairs[..., 0, :], pairs[..., 1, :]
    return jnp.stack([cos * a + sin * b, cos * b - sin * a], -2).reshape(x.shape)
