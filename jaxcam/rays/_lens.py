"""The two radial maps of `jaxcam.rays.lens`: how far they rise, and their inverses."""
# JAX's own annotations are partial.
# pyright: reportUnknownMemberType=false

import math
from functools import partial
from types import ModuleType
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from jaxcam.rays._arrays import Array, array_namespace

Lens = Literal["opencv", "fisheye"]
Coefficients = tuple[Array, ...]

_WIDEST = {"opencv": float(np.arctan(1e2)), "fisheye": np.pi / 2}
"""Up to which angle a fold is looked for."""
_CORNERS = 8


def _steps(values: Array) -> tuple[int, int]:
    """How many of Newton's steps are taken along the radius and in the plane."""
    return (6, 4) if values.dtype.itemsize <= 4 else (10, 7)


def split(distortion: Array, lens: Lens) -> tuple[Coefficients, Coefficients, Coefficients]:
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


def gain_of(above: Coefficients, below: Coefficients, s: Array) -> tuple[Array, Array]:
    """g(s) and g'(s)."""
    top, top_slope = _series(above, s)
    if not below:
        return top, top_slope
    bottom, bottom_slope = _series(below, s)
    gain = top / bottom
    return gain, (top_slope - gain * bottom_slope) / bottom


def field_limit(distortion: Array, lens: Lens, xp: ModuleType) -> Array:
    """Largest r (opencv; infinite if nothing folds) or θ (fisheye) of the field, `[...]`."""
    if xp is jnp:
        distortion = jax.lax.stop_gradient(distortion)
    above, below, _ = split(distortion[..., None, :], lens)
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


def tolerance(distance: Array) -> Array:
    """How exactly a solution must land on its pixel, in normalised coordinates."""
    return 64 * np.finfo(distance.dtype).eps * (1 + distance)


def _radius(distortion: Array, lens: Lens, limit: Array, distance: Array) -> Array:
    """The t with t g(t²) = distance: Newton's steps, halved where they leave the bracket."""
    xp = array_namespace(distance, limit)
    above, below, _ = split(distortion, lens)
    low = xp.zeros_like(distance)
    edge = high = xp.minimum(limit, 1e4) + low
    t = _rough_radius(distortion, lens, limit, distance)
    for _ in range(_steps(distance)[0]):
        s = t * t
        gain, slope = gain_of(above, below, s)
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
    above, below, _ = split(distortion[..., None, :], lens)
    end = limit if lens == "fisheye" else xp.arctan(limit)
    share = xp.arange(_CORNERS + 1, dtype=limit.dtype) / _CORNERS
    t = xp.minimum(end, 1.4)[..., None] * (1 - (1 - share) ** 1.5)  # denser where it flattens
    t = t if lens == "fisheye" else xp.tan(t)
    f = t * gain_of(above, below, t * t)[0]
    rough = xp.zeros_like(distance)
    for i in range(_CORNERS):
        rise, step = f[..., i + 1] - f[..., i], t[..., i + 1] - t[..., i]
        part = (distance - f[..., i]) / xp.maximum(rise, 1e-9)
        rough = rough + step * xp.clip(part, 0, 1)
    return rough


def squared_angle(distortion: Array, limit: Array, q: Array) -> Array:
    """θ² of a fisheye's pixels at a squared distance q from the middle."""
    xp = array_namespace(q, distortion)
    theta = _radius(distortion, "fisheye", limit, xp.sqrt(q))
    # Solved once, not anew wherever it is used.
    return theta * theta if xp is np else jax.lax.optimization_barrier(theta * theta)


squared_angle_jax = jax.custom_jvp(squared_angle)


@squared_angle_jax.defjvp
def _squared_angle_jvp(
    primals: tuple[Array, Array, Array], tangents: tuple[Array, Array, Array]
) -> tuple[Array, Array]:
    distortion, limit, q = primals
    s = squared_angle_jax(distortion, limit, q)

    def squared_distance(d: Array, s: Array) -> Array:
        return s * gain_of(*split(d, "fisheye")[:2], s)[0] ** 2

    _, moved = jax.jvp(partial(squared_distance, s=s), (distortion,), (tangents[0],))
    gain, slope = gain_of(*split(distortion, "fisheye")[:2], s)
    rise = gain * (gain + 2 * s * slope)
    return s, (tangents[2] - moved) / jnp.where(rise > 1e-6, rise, 1)


def _plane(distortion: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """The opencv model without its field: (x', y')."""
    above, below, (p1, p2) = split(distortion, "opencv")
    s = x * x + y * y
    gain, _ = gain_of(above, below, s)
    cross = 2 * x * y
    return (
        x * gain + p1 * cross + p2 * (s + 2 * x * x),
        y * gain + p1 * (s + 2 * y * y) + p2 * cross,
    )


def _jacobian(distortion: Array, x: Array, y: Array) -> tuple[Array, Array, Array]:
    """dx'/dx, dx'/dy = dy'/dx and dy'/dy of the opencv model."""
    above, below, (p1, p2) = split(distortion, "opencv")
    gain, slope = gain_of(above, below, x * x + y * y)
    return (
        gain + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x,
        2 * (x * y * slope + p1 * x + p2 * y),
        gain + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x,
    )


def undistort(distortion: Array, limit: Array, x2: Array, y2: Array) -> tuple[Array, Array, Array]:
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
    ok = (miss <= tolerance(distance + radius)) & (radius <= limit) & (a * c - b * b > 0)
    return xp.where(ok, x, 0), xp.where(ok, y, 0), ok.astype(x.dtype)


undistort_jax = jax.custom_jvp(undistort)


@undistort_jax.defjvp
def _undistort_jvp(
    primals: tuple[Array, Array, Array, Array], tangents: tuple[Array, Array, Array, Array]
) -> tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]:
    distortion = primals[0]
    x, y, ok = undistort_jax(*primals)
    _, moved = jax.jvp(partial(_plane, x=x, y=y), (distortion,), (tangents[0],))
    dx, dy = tangents[2] - moved[0], tangents[3] - moved[1]
    a, b, c = _jacobian(distortion, x, y)
    weight = ok / jnp.where(ok > 0, a * c - b * b, 1)
    along = (weight * (c * dx - b * dy), weight * (a * dy - b * dx), jnp.zeros_like(ok))
    return (x, y, ok), along


def atan_ratio(w: Array, xp: ModuleType) -> Array:
    """atan(√w) / √w, smooth at 0."""
    small = w < 1e-6
    root = xp.sqrt(xp.where(small, 1.0, w))
    return xp.where(small, 1 - w / 3, xp.arctan(root) / root)


def sinc(s: Array) -> Array:
    """sin(√s) / √s for s up to (π/2)², to the last digit of float64."""
    return _taylor(s, [1 / math.factorial(2 * n + 1) for n in range(12)])


def cosine(s: Array) -> Array:
    """cos(√s), likewise."""
    return _taylor(s, [1 / math.factorial(2 * n) for n in range(12)])


def _taylor(s: Array, terms: list[float]) -> Array:
    value = terms[-1]
    for term in reversed(terms[:-1]):
        value = term - s * value
    return value
