"""The ray-map: per pixel, the Plücker coordinates of the line of sight.

A pixel with normalised image coordinates (x, y) looks along `R @ (x, y, 1)`. That is affine in x
and in y, and so is its moment `C × d`: with r1, r2, r3 the columns of R,

    (d, m) = [ (r1, C×r1) x + (r2, C×r2) y + (r3, C×r3) ] / |r1 x + r2 y + r3|

so a whole map is one elementwise expression of a row vector and a column vector.
"""

from functools import partial
from typing import Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np

from jaxcam.errors import ConfigError, closest
from jaxcam.rays._arrays import Array
from jaxcam.rays._checks import check_camera

Convention = Literal["jaxcam", "authors"]


def plucker(
    K: Array,
    world_from_camera: Array,
    height: int,
    width: int,
    *,
    convention: Convention = "jaxcam",
) -> jax.Array:
    """Ray-map of a camera, or of a batch of cameras.

    Works under `jit`, `vmap` and `grad`. Values are checked when they are concrete; while tracing
    only shapes are.

    Args:
        K: Intrinsics in pixels of this image, `[..., 3, 3]`.
        world_from_camera: Camera pose, `[..., 4, 4]`, OpenCV axes (x right, y down, z forward).
            Leading axes broadcast against those of `K`. "World" is whichever frame the rays shall
            be in; policies use the robot base.
        height: Image rows.
        width: Image columns.
        convention: "jaxcam" is (direction, moment) through pixel centres (column + 0.5, row + 0.5).
            "authors" is what the paper's policies were trained on: (moment, direction), the pose in
            OpenGL axes (y up, looking along -z), pixels at +1.0, and 1e-8 added to the norm.

    Returns:
        Float32 `[..., height, width, 6]`: unit direction d and moment `m = C × d` in metres.

    Raises:
        CameraError: If a camera is impossible; the message names it.
    """
    check_camera(K, world_from_camera, height, width)
    return rays(_float32(K), _float32(world_from_camera), int(height), int(width), convention)


def _float32(a: Array) -> Array:
    # One dtype for everything NumPy, so that float64 and lists reuse the compiled function.
    return a if isinstance(a, jax.Array) else np.asarray(a, np.float32)


@partial(jax.jit, static_argnums=(2, 3, 4))
def rays(
    K: Array, world_from_camera: Array, height: int, width: int, convention: Convention
) -> jax.Array:
    """The ray-map without checks; see `plucker`."""
    if convention not in get_args(Convention):
        raise ConfigError(
            f"unknown ray convention '{convention}'{closest(str(convention), get_args(Convention))}"
        )
    authors = convention == "authors"
    offset, eps = (1.0, 1e-8) if authors else (0.5, 0.0)
    K = jnp.asarray(K, jnp.float32)
    pose = jnp.asarray(world_from_camera, jnp.float32)
    columns, centre = pose[..., :3, :3], pose[..., :3, 3]
    if authors:
        columns = columns * jnp.array([1.0, -1.0, -1.0], jnp.float32)

    # Fold the intrinsics into the basis: R @ inv(K) @ (u, v, 1) with u, v relative to (cx, cy).
    fx, fy, skew = K[..., 0, 0, None], K[..., 1, 1, None], K[..., 0, 1, None]
    r1 = columns[..., 0] / fx
    r2 = (columns[..., 1] - skew * r1) / fy
    r3 = columns[..., 2]
    u = jnp.arange(width, dtype=jnp.float32) + offset - K[..., 0, 2, None]
    v = jnp.arange(height, dtype=jnp.float32) + offset - K[..., 1, 2, None]

    def line(direction: jax.Array) -> jax.Array:
        moment = jnp.cross(centre, direction)
        parts = (moment, direction) if authors else (direction, moment)
        return jnp.concatenate(jnp.broadcast_arrays(*parts), axis=-1)

    def dot(a: jax.Array, b: jax.Array) -> jax.Array:
        return jnp.sum(a * b, axis=-1, keepdims=True)

    # Rows of width * 6 numbers, so that the innermost loop is long and contiguous.
    def along_row(coefficients: jax.Array) -> jax.Array:
        return jnp.tile(coefficients, width)

    u, v = jnp.repeat(u, 6, axis=-1), v[..., None]
    constant = (along_row(line(r1)) * u + along_row(line(r3)))[..., None, :]
    slope = along_row(line(r2))[..., None, :]
    norm2_0 = ((dot(r1, r1) * u + 2 * dot(r1, r3)) * u + dot(r3, r3))[..., None, :]
    norm2_1 = (2 * (dot(r1, r2) * u + dot(r2, r3)))[..., None, :]
    norm2_2 = dot(r2, r2)[..., None]
    norm = jnp.sqrt(norm2_0 + v * (norm2_1 + v * norm2_2))
    flat = (constant + v * slope) / (norm + eps)
    return flat.reshape(*flat.shape[:-1], width, 6)
