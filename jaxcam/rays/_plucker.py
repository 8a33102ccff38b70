"""The ray-map: per pixel, the Plücker coordinates of the line of sight.

A pixel with normalised image coordinates (x, y) looks along `R @ (x, y, 1)`. That is affine in x
and in y, and so is its moment `C × d`: with r1, r2, r3 the columns of R,

    (d, m) = [ (r1, C×r1) x + (r2, C×r2) y + (r3, C×r3) ] / |r1 x + r2 y + r3|

so a whole map is one elementwise expression of a row vector and a column vector. A lens makes x and
y depend on both: then they are solved for first (see `jaxcam.rays.lens`), as maps.
"""
# JAX's own annotations are partial, and K is K.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportConstantRedefinition=false

from functools import partial
from typing import Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np

from jaxcam.errors import CameraError, ConfigError, closest
from jaxcam.rays._arrays import Array
from jaxcam.rays._checks import check_camera
from jaxcam.rays.lens import Lens, check_distortion, normalised, sight_lines

Convention = Literal["jaxcam", "authors"]


def plucker(
    K: Array,
    world_from_camera: Array,
    height: int,
    width: int,
    *,
    convention: Convention = "jaxcam",
    distortion: Array | None = None,
    lens: Lens = "opencv",
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
        distortion: Coefficients of the lens, `[..., D]`, leading axes as those of `K`; a pinhole
            when left out. See `jaxcam.rays.lens`.
        lens: Which model they belong to: OpenCV's radial-tangential or its fisheye.

    Returns:
        Float32 `[..., height, width, 6]`: unit direction d and moment `m = C × d` in metres. Both
        are zero for a pixel outside the field of its lens, which has no ray.

    Raises:
        CameraError: If a camera is impossible; the message names it.
    """
    check_camera(K, world_from_camera, height, width)
    size = int(height), int(width)
    if distortion is not None:
        check_distortion(distortion, lens)
        distortion = _float32(distortion)
    ray_map: Array = rays(
        _float32(K), _float32(world_from_camera), *size, convention, distortion, lens
    )
    return ray_map


def patch_rays(
    K: Array,
    world_from_camera: Array,
    height: int,
    width: int,
    patch: int,
    *,
    distortion: Array | None = None,
    lens: Lens = "opencv",
) -> jax.Array:
    """One ray for each patch of a transformer: the line of sight of the patch's centre.

    This is what encodings of ray per token use (RayRoPE, RayPE). A patch embedding of the whole
    ray-map needs no function of its own: it is a convolution over `plucker`.

    Args:
        K: Intrinsics in pixels of the whole image, `[..., 3, 3]`.
        world_from_camera: Camera pose, `[..., 4, 4]`, OpenCV axes.
        height: Image rows, a multiple of `patch`.
        width: Image columns, likewise.
        patch: Side of a patch in pixels.
        distortion: Coefficients of the lens, `[..., D]`; a pinhole when left out.
        lens: Which model they belong to.

    Returns:
        Float32 `[..., height / patch, width / patch, 6]` (direction, moment), as `plucker` gives
        them.

    Raises:
        CameraError: If a camera is impossible or the patches do not tile the image.
    """
    check_camera(K, world_from_camera, height, width)
    if patch < 1 or height % patch or width % patch:
        raise CameraError(
            f"patches of {patch} pixels do not tile an image of {height} x {width} pixels. Resize "
            "the image (see Camera.resize) or choose another patch."
        )
    # The centres of patches are the centres of the pixels of an image as many times smaller.
    K = _float32(K) * np.array([[1 / patch], [1 / patch], [1]], np.float32)
    if distortion is not None:
        check_distortion(distortion, lens)
        distortion = _float32(distortion)
    pose, size = _float32(world_from_camera), (int(height) // patch, int(width) // patch)
    ray_map: Array = rays(K, pose, *size, "jaxcam", distortion, lens)
    return ray_map


def _float32(a: Array) -> Array:
    # One dtype for everything NumPy, so that float64 and lists reuse the compiled function.
    return a if isinstance(a, jax.Array) else np.asarray(a, np.float32)


@partial(jax.jit, static_argnames=("height", "width", "convention", "lens"))
def rays(
    K: Array,
    world_from_camera: Array,
    height: int,
    width: int,
    convention: Convention,
    distortion: Array | None = None,
    lens: Lens = "opencv",
) -> jax.Array:
    """The ray-map without checks; see `plucker`."""
    if convention not in get_args(Convention):
        raise ConfigError(
            f"unknown ray convention '{convention}'{closest(str(convention), get_args(Convention))}"
        )
    offset = 1.0 if convention == "authors" else 0.5
    K = jnp.asarray(K, jnp.float32)
    pose = jnp.asarray(world_from_camera, jnp.float32)
    u = jnp.arange(width, dtype=jnp.float32) + offset
    v = jnp.arange(height, dtype=jnp.float32) + offset
    if distortion is None:
        return _straight(K, pose, u, v, convention)
    bend = jnp.asarray(distortion, jnp.float32)[..., None, None, :]
    x, y = normalised(K[..., None, None, :, :], u, v[:, None])
    return _bent(pose, sight_lines(x, y, bend, lens), convention)


def _columns(pose: jax.Array, convention: Convention) -> jax.Array:
    """The rotation of a pose whose axes are the convention's, `[..., 3, 3]` in OpenCV axes."""
    rotation = pose[..., :3, :3]
    if convention == "authors":
        return rotation * jnp.array([1.0, -1.0, -1.0], jnp.float32)
    return rotation


def _line(centre: jax.Array, direction: jax.Array, convention: Convention) -> jax.Array:
    """Direction (of any length) and moment, `[..., 6]`, in the convention's order."""
    moment = jnp.cross(centre, direction)
    parts = (moment, direction) if convention == "authors" else (direction, moment)
    return jnp.concatenate(jnp.broadcast_arrays(*parts), axis=-1)


def _dot(a: jax.Array, b: jax.Array) -> jax.Array:
    return jnp.sum(a * b, axis=-1, keepdims=True)


def _straight(
    K: jax.Array, pose: jax.Array, u: jax.Array, v: jax.Array, convention: Convention
) -> jax.Array:
    """The ray-map of a pinhole through columns `u` `[width]` and rows `v` `[height]`."""
    eps = 1e-8 if convention == "authors" else 0.0
    width = len(u)
    columns, centre = _columns(pose, convention), pose[..., :3, 3]
    # Fold the intrinsics into the basis: R @ inv(K) @ (u, v, 1) with u, v relative to (cx, cy).
    fx, fy, skew = K[..., 0, 0, None], K[..., 1, 1, None], K[..., 0, 1, None]
    r1 = columns[..., 0] / fx
    r2 = (columns[..., 1] - skew * r1) / fy
    r3 = columns[..., 2]
    u, v = u - K[..., 0, 2, None], v - K[..., 1, 2, None]

    # Rows of width * 6 numbers, so that the innermost loop is long and contiguous.
    def along_row(direction: jax.Array) -> jax.Array:
        return jnp.tile(_line(centre, direction, convention), width)

    u, v = jnp.repeat(u, 6, axis=-1), v[..., None]
    constant = (along_row(r1) * u + along_row(r3))[..., None, :]
    slope = along_row(r2)[..., None, :]
    norm2_0 = ((_dot(r1, r1) * u + 2 * _dot(r1, r3)) * u + _dot(r3, r3))[..., None, :]
    norm2_1 = (2 * (_dot(r1, r2) * u + _dot(r2, r3)))[..., None, :]
    norm2_2 = _dot(r2, r2)[..., None]
    norm = jnp.sqrt(norm2_0 + v * (norm2_1 + v * norm2_2))
    flat = (constant + v * slope) / (norm + eps)
    return flat.reshape(*flat.shape[:-1], width, 6)


def _bent(
    pose: jax.Array, sight: tuple[jax.Array, jax.Array, jax.Array], convention: Convention
) -> jax.Array:
    """The ray-map of pixels that look along `sight`, three maps `[..., height, width]`."""
    eps = 1e-8 if convention == "authors" else 0.0
    columns, centre = _columns(pose, convention), pose[..., :3, 3]
    axes = [columns[..., i] for i in range(3)]
    # A pose read from a file is a rotation to four digits or so; the lengths are exact.
    norm2 = sum(
        sight[i] * sight[j] * _dot(axes[i], axes[j])[..., None] for i in range(3) for j in range(3)
    )
    norm = jnp.sqrt(jnp.where(sight[2] > 0, norm2, 1.0)) + eps
    # Solved once for all six channels.
    a, b, c = jax.lax.optimization_barrier(tuple(part / norm for part in sight))
    width = a.shape[-1]

    def along_row(direction: jax.Array) -> jax.Array:
        return jnp.tile(_line(centre, direction, convention), width)[..., None, :]

    flat = (
        along_row(axes[0]) * jnp.repeat(a, 6, axis=-1)
        + along_row(axes[1]) * jnp.repeat(b, 6, axis=-1)
        + along_row(axes[2]) * jnp.repeat(c, 6, axis=-1)
    )
    return flat.reshape(*flat.shape[:-1], width, 6)
