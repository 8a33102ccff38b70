"""Corners between squares to a few hundredths of a pixel.

OpenCV looks at where gradients point. Here the picture around a corner is explained: two edges,
each as blurred as the other, that cross; so all of the edges' pixels tell where, and noise of the
sensor tells little.
"""

import cv2
import numpy as np
from scipy.special import erf

LEAST, MOST = 3.0, 10.0
"""Radius (pixels) that must be free of other things for that, and what is looked at at most."""
BLURRED = 1.5
"""Pixels around other things that are not looked at."""
FAR = 1.0
"""Pixels that a corner may move by: what moves further was none."""
STEPS = 8
_ROOT = np.sqrt(2.0)


def refine_board(
    grey: np.ndarray, points: np.ndarray, pixels: np.ndarray, clear: np.ndarray
) -> np.ndarray:
    """Corners of a board, from the picture around each.

    Args:
        grey: The picture, uint8 [H, W].
        points: Corners in the board's plane, [n, 2] (m); squares lie along its axes.
        pixels: Where they are, roughly, [n, 2], as OpenCV counts pixels.
        clear: From a corner, the nearest things that are not its four squares, [k, 2] (m).

    Returns:
        Pixels [n, 2].
    """
    plane = cv2.findHomography(points, pixels)[0]
    if plane is None or not np.isfinite(plane).all():
        return pixels

    def seen(places: np.ndarray) -> np.ndarray:
        flat = np.c_[places, np.ones(len(places))] @ plane.T
        return flat[:, :2] / flat[:, 2:]

    with np.errstate(divide="ignore", invalid="ignore"):
        own, step = seen(points), 0.05 * np.abs(clear).max()
        along = np.stack([seen(points + way) - own for way in step * np.eye(2)], 1)
        free = [np.linalg.norm(seen(points + way) - own, axis=-1) for way in clear]
    radius = np.nan_to_num(np.min(free, 0) - BLURRED, nan=0.0)
    return refine_crossings(grey, pixels, np.nan_to_num(along), radius)


def refine_crossings(
    grey: np.ndarray, corners: np.ndarray, along: np.ndarray, radius: np.ndarray
) -> np.ndarray:
    """Corners of a chessboard, from the picture around them.

    Args:
        grey: The picture, uint8 [H, W].
        corners: Roughly, [n, 2], as OpenCV counts pixels.
        along: Directions of the two edges at each, [n, 2, 2], of any length.
        radius: How far from each nothing but its four squares is seen, [n] (pixels).

    Returns:
        Corners [n, 2]; as given where the picture is explained badly, or ends.
    """
    reach = np.clip(np.floor(radius), 0, MOST)
    limit = np.array(grey.shape[::-1]) - 1 - reach[:, None]
    usable = (reach >= LEAST) & ((corners >= reach[:, None]) & (corners <= limit)).all(-1)
    if not usable.any():
        return corners
    result = corners.astype(float)
    result[usable] = _explained(grey, result[usable], along[usable], reach[usable])
    return result


def _explained(
    grey: np.ndarray, corners: np.ndarray, along: np.ndarray, reach: np.ndarray
) -> np.ndarray:
    """Gauss's and Newton's steps for all corners at once; as given where they lead nowhere."""
    grid = np.arange(-reach.max(), reach.max() + 1)
    offsets = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    middle = np.rint(corners)
    at = np.clip(middle[:, None] + offsets, 0, np.array(grey.shape[::-1]) - 1).astype(int)
    light = grey[at[..., 1], at[..., 0]].astype(float)
    weight = np.linalg.norm(middle[:, None] + offsets - corners[:, None], axis=-1) <= reach[:, None]
    turn = np.arctan2(along[..., 1], along[..., 0])
    count = len(corners)
    x = np.zeros((count, 5))  # place from the middle, angles of both edges, log of the blur
    x[:, :2], x[:, 2:4] = corners - middle, turn
    damping, cost, done = np.full(count, 1e-3), np.full(count, np.inf), x.copy()
    normal, side = np.zeros((count, 5, 5)), np.zeros((count, 5))
    for _ in range(STEPS):
        residual, J = _residuals(x, offsets, light, weight)
        value = (residual**2).sum(-1)
        better = value < cost
        cost, done = np.where(better, value, cost), np.where(better[:, None], x, done)
        damping = np.clip(np.where(better, damping / 8, damping * 8), 1e-6, 1e6)
        normal = np.where(better[:, None, None], np.einsum("nip,niq->npq", J, J), normal)
        side = np.where(better[:, None], np.einsum("nip,ni->np", J, residual), side)
        scale = np.einsum("npp->np", normal) + 1e-9
        heavy = normal + damping[:, None, None] * np.eye(5) * scale[:, None]
        x = done - np.linalg.solve(heavy + 1e-9 * np.eye(5), side[..., None])[..., 0]
        x[:, :2] = np.clip(x[:, :2], -MOST, MOST)
        x[:, 4] = np.clip(x[:, 4], np.log(0.3), np.log(3.0))
    ahead = middle + done[:, :2]
    near = np.linalg.norm(ahead - corners, axis=-1) < FAR
    contrast = (light * weight).max(-1) - np.where(weight, light, 255.0).min(-1)
    clear = np.sqrt(cost / np.maximum(weight.sum(-1), 1)) < 0.2 * contrast
    return np.where((near & clear)[:, None], ahead, corners)


def _residuals(
    x: np.ndarray, offsets: np.ndarray, light: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What is left of the light [n, pixels], and its derivatives by `x` [n, pixels, 5].

    Light is brightness, contrast and a slope of brightness, which follow by least squares.
    """
    d = offsets[None] - x[:, None, :2]
    blur = np.exp(x[:, 4])[:, None]
    cosine, sine = np.cos(x[:, 2:4]), np.sin(x[:, 2:4])
    # Signed distances from both edges, and their derivatives by the angles.
    s = d[..., 0, None] * -sine[:, None] + d[..., 1, None] * cosine[:, None]
    t = -d[..., 0, None] * cosine[:, None] - d[..., 1, None] * sine[:, None]
    z = s / (_ROOT * blur[..., None])
    e, g = erf(z), np.exp(-(z**2)) * 2 / np.sqrt(np.pi) / (_ROOT * blur[..., None])
    pattern = e[..., 0] * e[..., 1]
    cross = np.stack([g[..., 0] * e[..., 1], e[..., 0] * g[..., 1]], -1)
    slopes = np.stack([
        (cross * sine[:, None]).sum(-1), (cross * -cosine[:, None]).sum(-1),
        cross[..., 0] * t[..., 0], cross[..., 1] * t[..., 1], -(cross * s).sum(-1),
    ], -1)  # fmt: skip
    basis = np.stack([np.broadcast_to(one, pattern.shape) for one in (
        pattern, np.ones(1), offsets[:, 0] / MOST, offsets[:, 1] / MOST)], -1)  # fmt: skip
    basis = basis * weight[..., None]
    normal = np.einsum("nip,niq->npq", basis, basis) + 1e-9 * np.eye(4)
    fit = np.linalg.solve(normal, np.einsum("nip,ni->np", basis, light)[..., None])[..., 0]
    residual = np.einsum("nip,np->ni", basis, fit) - light * weight
    J = fit[:, :1, None] * slopes * weight[..., None]
    # What the light's own numbers take up does not count (Kaufman's variable projection).
    taken = np.linalg.solve(normal, np.einsum("nip,niq->npq", basis, J))
    return residual, J - np.einsum("nip,npq->niq", basis, taken)
