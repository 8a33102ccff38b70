"""Lenses: where glass moves the image of a point, and which way a pixel looks through it.

A point (X, Y, Z) in camera axes has the normalised coordinates x = X/Z, y = Y/Z. A lens moves them
to (x', y'), and K makes a pixel of those. Two models, as OpenCV defines them:

    opencv    (x', y') = (x, y) g(r²) + decentring,  r² = x² + y²,
              g(s) = (1 + k1 s + k2 s² + k3 s³) / (1 + k4 s + k5 s² + k6 s³),
              decentring = (2 p1 xy + p2 (r² + 2x²), p1 (r² + 2y²) + 2 p2 xy)
              coefficients (k1, k2, p1, p2), then k3, then k4, k5, k6: 4, 5 or 8
    fisheye   (x', y') = (x, y) / r · θ g(θ²),  θ = atan r,  g(s) = 1 + k1 s + k2 s² + k3 s³ + k4 s⁴
              coefficients (k1, k2, k3, k4)

Both have four coefficients, so `lens` says which is meant. Coefficients of several cameras with
lenses of both kinds (or of none) go into one array with `pack`.

**The field.** Radially, the image moves outwards with the angle only up to some angle; beyond it a
polynomial folds back and means nothing. What lies beyond, or beside the camera, is outside the
field: a pixel that nothing in the field lands on has no ray. Its direction and moment are zero.
"""
# JAX's own annotations are partial, and K is K.
# pyright: reportUnknownMemberType=false, reportConstantRedefinition=false

from types import ModuleType
from typing import get_args

import numpy as np

from jaxcam.errors import CameraError, ConfigError, closest
from jaxcam.rays._arrays import Array, array_namespace, as_float, is_concrete
from jaxcam.rays._checks import LARGEST
from jaxcam.rays._lens import (
    Lens,
    atan_ratio,
    cosine,
    field_limit,
    gain_of,
    sinc,
    split,
    squared_angle,
    squared_angle_jax,
    tolerance,
    undistort,
    undistort_jax,
)

PACKED = 9
"""Coefficients of a lens from `pack`."""

_LENGTHS: dict[Lens, tuple[int, ...]] = {"opencv": (4, 5, 8), "fisheye": (4,)}


def check_distortion(distortion: Array, lens: Lens, name: str = "camera") -> None:
    """Raise `CameraError` unless these can be the coefficients of a lens.

    Args:
        distortion: `[..., D]`; values are looked at where they are concrete.
        lens: The model.
        name: What to call the camera in the message.
    """
    if lens not in get_args(Lens):
        raise ConfigError(f"unknown lens '{lens}'{closest(str(lens), get_args(Lens))}")
    shape = np.shape(distortion)
    if not shape or shape[-1] not in (*_LENGTHS[lens], PACKED):
        known = " or ".join(map(str, (*_LENGTHS[lens], PACKED)))
        raise CameraError(
            f"{name}: distortion has the wrong shape. Expected [..., {known}] for lens='{lens}', "
            f"got {list(shape)}. Likely cause: a column instead of a row, a fisheye without "
            "lens='fisheye', or thin-prism and tilt coefficients, which jaxcam does not know."
        )
    if not is_concrete(distortion):
        return
    values = np.asarray(distortion)
    if not (np.issubdtype(values.dtype, np.number) and (np.abs(values) <= LARGEST).all()):
        raise CameraError(
            f"{name}: values of distortion: expected finite numbers up to {LARGEST:g}, got "
            f"{values.tolist()}. Likely cause: a failed calibration."
        )
    if shape[-1] == PACKED and not np.isin(values[..., -1], (0, 1)).all():
        raise CameraError(
            f"{name}: the ninth coefficient of a packed lens is 0 (opencv) or 1 (fisheye), got "
            f"{values[..., -1].tolist()}. See jaxcam.rays.lens.pack."
        )


def pack(distortion: Array, lens: Lens = "opencv") -> Array:
    """Coefficients of either model in one form, so that cameras of both fit in one array.

    Args:
        distortion: `[..., D]`.
        lens: The model.

    Returns:
        `[..., 9]`: the coefficients, zeros, and 0 for opencv or 1 for fisheye. Functions that take
        `distortion` take this whatever their `lens` says; nine zeros are a pinhole.

    Raises:
        CameraError: If there is no such lens.
    """
    check_distortion(distortion, lens)
    xp = array_namespace(distortion)
    given = as_float(distortion, xp)
    if given.shape[-1] == PACKED:
        return given
    kind = xp.full((*given.shape[:-1], 1), lens == "fisheye", given.dtype)
    zeros = xp.zeros((*given.shape[:-1], PACKED - 1 - given.shape[-1]), given.dtype)
    return xp.concatenate([given, zeros, kind], axis=-1)


def valid(K: Array, height: int, width: int, distortion: Array, *, lens: Lens = "opencv") -> Array:
    """Which pixels have a ray.

    Args:
        K: Intrinsics in pixels of this image, `[..., 3, 3]`.
        height: Image rows.
        width: Image columns.
        distortion: Coefficients `[..., D]`.
        lens: The model.

    Returns:
        Bool `[..., height, width]`.

    Raises:
        CameraError: If there is no such lens.
    """
    check_distortion(distortion, lens)
    xp = array_namespace(K, distortion)
    K = as_float(K, xp)[..., None, None, :, :]
    distortion = as_float(distortion, xp)[..., None, None, :]
    u = xp.arange(width, dtype=K.dtype) + 0.5
    v = xp.arange(height, dtype=K.dtype)[:, None] + 0.5
    return sight_lines(*normalised(K, u, v), distortion, lens)[2] > 0


def normalised(K: Array, u: Array, v: Array) -> tuple[Array, Array]:
    """Normalised coordinates (x', y') of pixels: what K does, undone; the lens is not.

    Args:
        K: Intrinsics `[..., 3, 3]` whose leading axes broadcast against those of the pixels.
        u: Columns `[...]`.
        v: Rows `[...]`.
    """
    y = (v - K[..., 1, 2]) / K[..., 1, 1]
    return (u - K[..., 0, 2] - K[..., 0, 1] * y) / K[..., 0, 0], y


def distort(x: Array, y: Array, distortion: Array, lens: Lens) -> tuple[Array, Array, Array]:
    """Where a lens puts points.

    Args:
        x: Normalised coordinates X/Z `[...]` of points in front of the camera.
        y: Likewise Y/Z.
        distortion: `[..., D]`, leading axes broadcast against those of `x`.
        lens: The model.

    Returns:
        (x', y') `[...]` and whether the point is in the field; (0, 0) where it is not.
    """
    xp = array_namespace(x, y, distortion)
    if distortion.shape[-1] == PACKED:
        plain, fisheye, is_fisheye = _unpack(distortion, xp)
        one, other = distort(x, y, plain, "opencv"), distort(x, y, fisheye, "fisheye")
        return _choose(is_fisheye, other, one, xp)
    above, below, decentring = split(distortion, lens)
    limit = field_limit(distortion, lens, xp)
    w = x * x + y * y
    shrink = atan_ratio(w, xp) if lens == "fisheye" else 1.0
    inside = w * shrink * shrink <= limit * limit
    x, y, w = (xp.where(inside, a, 0) for a in (x, y, w))
    if lens == "fisheye":
        shrink = atan_ratio(w, xp)
    gain, _ = gain_of(above, below, w * shrink * shrink)
    x2, y2 = x * shrink * gain, y * shrink * gain
    if decentring:
        p1, p2 = decentring
        x2 = x2 + 2 * p1 * x * y + p2 * (w + 2 * x * x)
        y2 = y2 + p1 * (w + 2 * y * y) + 2 * p2 * x * y
    return x2, y2, inside


def sight_lines(x: Array, y: Array, distortion: Array, lens: Lens) -> tuple[Array, Array, Array]:
    """Which way pixels look: the inverse of `distort`.

    Solved by a fixed number of steps; derivatives are those of the exact inverse, of any order.

    Args:
        x: Normalised coordinates x' `[...]` of pixels, see `normalised`.
        y: Likewise y'.
        distortion: `[..., D]`, leading axes broadcast against those of `x`.
        lens: The model.

    Returns:
        A vector in camera axes, three arrays `[...]`: not of unit length, z > 0; all zero where a
        pixel has no ray.
    """
    xp = array_namespace(x, y, distortion)
    if distortion.shape[-1] == PACKED:
        plain, fisheye, is_fisheye = _unpack(distortion, xp)
        one, other = sight_lines(x, y, plain, "opencv"), sight_lines(x, y, fisheye, "fisheye")
        return _choose(is_fisheye, other, one, xp)
    limit = field_limit(distortion, lens, xp)
    if lens == "opencv":
        solve = undistort if xp is np else undistort_jax
        x, y, ok = solve(distortion, limit, *xp.broadcast_arrays(x, y))
        return x, y, ok
    q = x * x + y * y
    s = (squared_angle if xp is np else squared_angle_jax)(distortion, limit, q)
    gain, _ = gain_of(*split(distortion, lens)[:2], s)
    theta, distance = xp.sqrt(xp.where(s > 0, s, 0)), xp.sqrt(xp.where(q > 0, q, 0))
    ok = (xp.abs(theta * gain - distance) <= tolerance(distance)) & (theta < limit)
    ratio = xp.where(ok, sinc(s) / xp.where(ok, gain, 1), 0)
    return x * ratio, y * ratio, xp.where(ok, cosine(s), 0)


def _unpack(distortion: Array, xp: ModuleType) -> tuple[Array, Array, Array]:
    is_fisheye = distortion[..., PACKED - 1] == 1
    plain = xp.where(is_fisheye[..., None], 0, distortion[..., : PACKED - 1])
    return plain, xp.where(is_fisheye[..., None], distortion[..., :4], 0), is_fisheye


def _choose(
    which: Array, yes: tuple[Array, ...], no: tuple[Array, ...], xp: ModuleType
) -> tuple[Array, Array, Array]:
    a, b, c = (xp.where(which, *pair) for pair in zip(yes, no, strict=True))
    return a, b, c
