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

import math
from functools import partial
from types import ModuleType
from typing import Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np

from jaxcam.errors import CameraError, ConfigError, closest
from jaxcam.rays._arrays import Array, array_namespace, as_float, is_concrete
from jaxcam.rays._checks import LARGEST

Lens = Literal["opencv", "fisheye"]
PACKED = 9
"""Coefficients of a lens from `pack`."""

_LENGTHS: dict[Lens, tuple[int, ...]] = {"opencv": (4, 5, 8), "fisheye": (4,)}
_WIDEST = {"opencv": float(np.arctan(1e2)), "fisheye": np.pi / 2}
"""Up to which angle a fold is looked for."""
_CORNERS = 8


def _steps(values: Array) -> tuple[int, int]:
    """How many of Newton's steps are taken along the radius and in the plane."""
    return (6, 4) if values.dtype.itemsize <= 4 else (10, 7)


Coefficients = tuple[Array, ...]


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
    above, below, decentring = _split(distortion, lens)
    limit = _limit(distortion, lens, xp)
    w = x * x + y * y
    shrink = _atan_ratio(w, xp) if lens == "fisheye" else 1.0
    inside = w * shrink * shrink <= limit * limit
    x, y, w = (xp.where(inside, a, 0) for a in (x, y, w))
    if lens == "fisheye":
        shrink = _atan_ratio(w, xp)
    gain, _ = _gain(above, below, w * shrink * shrink)
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
    limit = _limit(distortion, lens, xp)
    if lens == "opencv":
        solve = _undistort if xp is np else _undistort_jax
        x, y, ok = solve(distortion, limit, *xp.broadcast_arrays(x, y))
        return x, y, ok
    q = x * x + y * y
    s = (_squared_angle if xp is np else _squared_angle_jax)(distortion, limit, q)
    gain, _ = _gain(*_split(distortion, lens)[:2], s)
    theta, distance = xp.sqrt(xp.where(s > 0, s, 0)), xp.sqrt(xp.where(q > 0, q, 0))
    ok = (xp.abs(theta * gain - distance) <= _tolerance(distance)) & (theta < limit)
    ratio = xp.where(ok, _sinc(s) / xp.where(ok, gain, 1), 0)
    return x * ratio, y * ratio, xp.where(ok, _cosine(s), 0)


def _unpack(distortion: Array, xp: ModuleType) -> tuple[Array, Array, Array]:
    is_fisheye = distortion[..., PACKED - 1] == 1
    plain = xp.where(is_fisheye[..., None], 0, distortion[..., : PACKED - 1])
    return plain, xp.where(is_fisheye[..., None], distortion[..., :4], 0), is_fisheye


def _choose(
    which: Array, yes: tuple[Array, ...], no: tuple[Array, ...], xp: ModuleType
) -> tuple[Array, Array, Array]:
    a, b, c = (xp.where(which, *pair) for pair in zip(yes, no, strict=True))
    return a, b, c


def _split(distortion: Array, lens: Lens) -> tuple[Coefficients, Coefficients, Coefficients]:
    """Coefficients of the gain, above and below the fraction's line, and those of decentring."""
    k = tuple(distortion[..., i] for i in range(distortion.shape[-1]))
    if lens == "fisheye":
        return k, (), ()
    return (*k[:2], *k[4:5]), k[5:8], k[2:4]


def _series(coefficients: Coefficients, s: Array) -> tuple[Array, Array]:
    """1 + c1 s + c2 s² + … and its derivative."""
    value, slope = coefficients[-1], 0.0
    for c in reversed(coefficients[:-1]):
        slope = slope * s + value
        value = value * s + c
    return 1 + s * value, value + s * slope


def _gain(above: Coefficients, below: Coefficients, s: Array) -> tuple[Array, Array]:
    """g(s) and g'(s)."""
    top, top_slope = _series(above, s)
    if not below:
        return top, top_slope
    bottom, bottom_slope = _series(below, s)
    gain = top / bottom
    return gain, (top_slope - gain * bottom_slope) / bottom


def _limit(distortion: Array, lens: Lens, xp: ModuleType) -> Array:
    """Largest r (opencv; infinite if nothing folds) or θ (fisheye) of the field, `[...]`."""
    if xp is jnp:
        distortion = jax.lax.stop_gradient(distortion)
    above, below, _ = _split(distortion[..., None, :], lens)
    cells = 256
    steps = xp.arange(1, cells + 1, dtype=distortion.dtype) / cells
    low = xp.zeros_like(distortion[..., 0])
    size = low + _WIDEST[lens]
    folds = low < 0
    for level in range(3):
        t = low[..., None] + size[..., None] * steps
        s = t * t if lens == "fisheye" else xp.tan(t) ** 2
        top, top_slope = _series(above, s)
        bottom, bottom_slope = _series(below, s) if below else (xp.ones_like(top), 0.0)
        # The sign of d(t g)/dt, times the square of what is below the line.
        rise = top * bottom + 2 * s * (top_slope * bottom - top * bottom_slope)
        bad = ~((rise > 0) & (bottom > 0))
        if level == 0:
            folds = bad.any(-1)
        first = xp.where(bad.any(-1), xp.argmax(bad, axis=-1), cells - 1)
        size = size / cells
        low = low + first.astype(size.dtype) * size
    if lens == "fisheye":
        return xp.where(folds, low, xp.asarray(_WIDEST[lens], low.dtype)).astype(low.dtype)
    return xp.where(folds, xp.tan(low), xp.asarray(np.inf, low.dtype)).astype(low.dtype)


def _tolerance(distance: Array) -> Array:
    """How exactly a solution must land on its pixel, in normalised coordinates."""
    return 64 * np.finfo(distance.dtype).eps * (1 + distance)


def _radius(distortion: Array, lens: Lens, limit: Array, distance: Array) -> Array:
    """The t with t g(t²) = distance: Newton's steps, halved where they leave the bracket."""
    xp = array_namespace(distance, limit)
    above, below, _ = _split(distortion, lens)
    low = xp.zeros_like(distance)
    edge = high = xp.minimum(limit, 1e4) + low
    t = _rough_radius(distortion, lens, limit, distance)
    for _ in range(_steps(distance)[0]):
        s = t * t
        gain, slope = _gain(above, below, s)
        excess = t * gain - distance
        low, high = xp.where(excess < 0, t, low), xp.where(excess < 0, high, t)
        ahead = xp.minimum(t - excess / xp.maximum(gain + 2 * s * slope, 1e-6), edge)
        # Some room: compilers round what is computed twice differently, also beside a solution.
        room = 1e-3 * t
        inside = (ahead >= low - room) & (ahead <= high + room)
        t = xp.where(inside, ahead, 0.5 * (low + high))
    return t


def _rough_radius(distortion: Array, lens: Lens, limit: Array, distance: Array) -> Array:
    """About that t: the inverse of the polygon through some points of the radial map."""
    xp = array_namespace(distance, limit)
    above, below, _ = _split(distortion[..., None, :], lens)
    end = limit if lens == "fisheye" else xp.arctan(limit)
    share = xp.arange(_CORNERS + 1, dtype=limit.dtype) / _CORNERS
    t = xp.minimum(end, 1.4)[..., None] * (1 - (1 - share) ** 1.5)  # denser where it flattens
    t = t if lens == "fisheye" else xp.tan(t)
    f = t * _gain(above, below, t * t)[0]
    rough = xp.zeros_like(distance)
    for i in range(_CORNERS):
        rise, step = f[..., i + 1] - f[..., i], t[..., i + 1] - t[..., i]
        part = (distance - f[..., i]) / xp.maximum(rise, 1e-9)
        rough = rough + step * xp.clip(part, 0, 1)
    return rough


def _squared_angle(distortion: Array, limit: Array, q: Array) -> Array:
    """θ² of a fisheye's pixels at a squared distance q from the middle."""
    xp = array_namespace(q, distortion)
    theta = _radius(distortion, "fisheye", limit, xp.sqrt(q))
    # Solved once, not anew wherever it is used.
    return theta * theta if xp is np else jax.lax.optimization_barrier(theta * theta)


_squared_angle_jax = jax.custom_jvp(_squared_angle)


@_squared_angle_jax.defjvp
def _squared_angle_jvp(
    primals: tuple[Array, Array, Array], tangents: tuple[Array, Array, Array]
) -> tuple[Array, Array]:
    distortion, limit, q = primals
    s = _squared_angle_jax(distortion, limit, q)

    def squared_distance(d: Array, s: Array) -> Array:
        return s * _gain(*_split(d, "fisheye")[:2], s)[0] ** 2

    _, moved = jax.jvp(partial(squared_distance, s=s), (distortion,), (tangents[0],))
    gain, slope = _gain(*_split(distortion, "fisheye")[:2], s)
    rise = gain * (gain + 2 * s * slope)
    return s, (tangents[2] - moved) / jnp.where(rise > 1e-6, rise, 1)


def _plane(distortion: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """The opencv model without its field: (x', y')."""
    above, below, (p1, p2) = _split(distortion, "opencv")
    s = x * x + y * y
    gain, _ = _gain(above, below, s)
    cross = 2 * x * y
    return (
        x * gain + p1 * cross + p2 * (s + 2 * x * x),
        y * gain + p1 * (s + 2 * y * y) + p2 * cross,
    )


def _jacobian(distortion: Array, x: Array, y: Array) -> tuple[Array, Array, Array]:
    """dx'/dx, dx'/dy = dy'/dx and dy'/dy of the opencv model."""
    above, below, (p1, p2) = _split(distortion, "opencv")
    gain, slope = _gain(above, below, x * x + y * y)
    return (
        gain + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x,
        2 * (x * y * slope + p1 * x + p2 * y),
        gain + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x,
    )


def _undistort(distortion: Array, limit: Array, x2: Array, y2: Array) -> tuple[Array, Array, Array]:
    """(x, y, 1) of the opencv model's pixels, or zeros."""
    xp = array_namespace(x2, distortion)
    distance = xp.sqrt(x2 * x2 + y2 * y2)
    scale = _radius(distortion, "opencv", limit, distance) / xp.maximum(distance, 1e-12)
    x, y = x2 * scale, y2 * scale
    for _ in range(_steps(distance)[1]):
        a, b, c = _jacobian(distortion, x, y)
        fx, fy = _plane(distortion, x, y)
        fx, fy = fx - x2, fy - y2
        det = a * c - b * b
        det = xp.where(xp.abs(det) < 1e-6, 1e-6, det)
        # A solution is at most a little outside; kept finite, so that nothing overflows.
        x = xp.clip(x - (c * fx - b * fy) / det, -1e4, 1e4)
        y = xp.clip(y - (a * fy - b * fx) / det, -1e4, 1e4)
    a, b, c = _jacobian(distortion, x, y)
    fx, fy = _plane(distortion, x, y)
    radius = xp.sqrt(x * x + y * y)
    miss = xp.maximum(xp.abs(fx - x2), xp.abs(fy - y2))
    ok = (miss <= _tolerance(distance + radius)) & (radius <= limit) & (a * c - b * b > 0)
    return xp.where(ok, x, 0), xp.where(ok, y, 0), ok.astype(x.dtype)


_undistort_jax = jax.custom_jvp(_undistort)


@_undistort_jax.defjvp
def _undistort_jvp(
    primals: tuple[Array, Array, Array, Array], tangents: tuple[Array, Array, Array, Array]
) -> tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]:
    distortion = primals[0]
    x, y, ok = _undistort_jax(*primals)
    _, moved = jax.jvp(partial(_plane, x=x, y=y), (distortion,), (tangents[0],))
    dx, dy = tangents[2] - moved[0], tangents[3] - moved[1]
    a, b, c = _jacobian(distortion, x, y)
    weight = ok / jnp.where(ok > 0, a * c - b * b, 1)
    along = (weight * (c * dx - b * dy), weight * (a * dy - b * dx), jnp.zeros_like(ok))
    return (x, y, ok), along


def _atan_ratio(w: Array, xp: ModuleType) -> Array:
    """atan(√w) / √w, smooth at 0."""
    small = w < 1e-6
    root = xp.sqrt(xp.where(small, 1.0, w))
    return xp.where(small, 1 - w / 3, xp.arctan(root) / root)


def _sinc(s: Array) -> Array:
    """sin(√s) / √s for s up to (π/2)², to the last digit of float64."""
    return _taylor(s, [1 / math.factorial(2 * n + 1) for n in range(12)])


def _cosine(s: Array) -> Array:
    """cos(√s), likewise."""
    return _taylor(s, [1 / math.factorial(2 * n) for n in range(12)])


def _taylor(s: Array, terms: list[float]) -> Array:
    value = terms[-1]
    for term in reversed(terms[:-1]):
        value = term - s * value
    return value
