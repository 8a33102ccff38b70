"""Where the arm's edge is in a picture: along the normals of where it is thought to be.

What the arm uncovers in other pictures of an episode is its background. A picture less its
background is nothing outside the arm and something inside; between them is the edge. A shadow is
something, too: of several edges the nearest that is strong counts.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np

STEP = 0.5
"""Pixels between samples along a normal."""
SIDE = 3.0
"""Pixels on each side of an edge that are compared."""
BLURRED = 3
"""Samples on each side of a cut that may be blurred."""
NOISE = 4.0
"""Levels (of 255) by which sides differ without an edge."""
CLEAR = 4.0
"""How many times the noise the sides of an edge differ at least."""


@dataclass(frozen=True)
class EdgeOffsets:
    """Edges along normals."""

    offsets: np.ndarray = field(repr=False)
    """From where the edge was thought to be, outwards (pixels), [n]."""
    clear: np.ndarray = field(repr=False)
    """Whether there is one, bool [n]."""
    contrast: np.ndarray = field(repr=False)
    """By how much its sides differ (levels), [n]."""


def behind_arm(rgb: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """What is behind the arm, float32 [h, w, 3]: the median of what it does not cover.

    Args:
        rgb: Pictures of one episode, [n, h, w, 3].
        covered: Where the arm may be, bool [n, h, w].

    Returns:
        NaN where it always is, and where it never is.
    """
    result = np.full(rgb.shape[1:], np.nan, np.float32)
    wanted = covered.any(0) & ~covered.all(0)
    values = np.where(covered[:, wanted, None], np.inf, rgb[:, wanted].astype(np.float32))
    count = (~covered[:, wanted]).sum(0)
    values.sort(0)  # what is covered comes last
    low, high = ((count - 1 + i) // 2 for i in (0, 1))
    both = [np.take_along_axis(values, at[None, :, None], 0)[0] for at in (low, high)]
    result[wanted] = (both[0] + both[1]) / 2
    return result


def find_edges(
    difference: np.ndarray, pixels: np.ndarray, normals: np.ndarray, reach: float
) -> EdgeOffsets:
    """Where edges are along normals.

    Args:
        difference: A picture less its background, float32 [h, w, 3]; NaN where that is not known.
        pixels: Where edges are thought to be, [n, 2].
        normals: Outwards, [n, 2].
        reach: How far is looked (pixels).
    """
    if not len(pixels):  # which OpenCV refuses
        return EdgeOffsets(np.zeros(0), np.zeros(0, bool), np.zeros(0))
    side = round(SIDE / STEP)
    along = np.arange(-reach - SIDE, reach + SIDE + STEP / 2, STEP)
    at = pixels[:, None] + along[:, None] * normals[:, None] - 0.5
    x, y = at[..., 0].astype(np.float32), at[..., 1].astype(np.float32)
    values = cv2.remap(difference, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT,
                       borderValue=(np.nan,) * 3)  # fmt: skip
    known = np.isfinite(values[..., 0])
    values = np.where(known[..., None], values, 0)
    cut = np.arange(side, len(along) - side + 1)

    def over(array: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Means of an array [n, samples, …] between samples."""
        pad = ((0, 0), (1, 0), *[(0, 0)] * (array.ndim - 2))
        sums = np.cumsum(np.pad(array, pad), 1)
        return (sums[:, last] - sums[:, first]) / (last - first)[0]

    inner, outer = over(values, cut - side, cut), over(values, cut, cut + side)
    whole = over(known.astype(float), cut - side, cut + side) > 0.999
    within = over((values**2).sum(-1), cut - side, cut + side)
    within = within - ((inner**2).sum(-1) + (outer**2).sum(-1)) / 2
    between = ((inner - outer) ** 2).sum(-1)
    # A cut lies before its sample.
    places = along[0] + (cut - 0.5) * STEP
    rising = (inner**2).sum(-1) < 0.25 * (outer**2).sum(-1)  # the arm lies within
    score = between / (np.maximum(within, 0) + NOISE**2)
    score = np.where(whole, score, 0)
    rows = np.arange(len(pixels))
    best = (np.where(rising, 0, score) * np.exp(-0.5 * (places / (0.6 * reach + 1)) ** 2)).argmax(1)
    for _ in range(3):  # nearness chooses among edges, but does not move them
        around = np.clip(best[:, None] + [-1, 0, 1], 0, score.shape[1] - 1)
        best = around[rows, score[rows[:, None], around].argmax(1)]
    best = np.clip(best, 1, score.shape[1] - 2)
    a, b, c = (score[rows, best + i] for i in (-1, 0, 1))
    offsets = places[best] + STEP * _halfway(values, best + side, inner, outer)
    contrast = np.sqrt(between[rows, best])
    clear = (
        ~rising[rows, best]
        & (b > 0)
        & (b >= a)
        & (b >= c)
        & (contrast > CLEAR * NOISE)
        & (abs(offsets) <= reach)
    )
    return EdgeOffsets(offsets, clear, contrast)


def _halfway(
    values: np.ndarray, cut: np.ndarray, inner: np.ndarray, outer: np.ndarray
) -> np.ndarray:
    """Where profiles are halfway between both sides of a cut: samples outwards from it, [n].

    A hand in motion is blurred, and so is what a lens makes of an edge: the edge is the middle of
    the ramp, not its steepest part. Where there is no such place, the cut stays.

    Args:
        values: Profiles, [n, samples, 3].
        cut: The sample that begins the outer side, [n].
        inner: The inner side's mean for every cut, [n, cuts, 3].
        outer: Likewise.
    """
    rows, side = np.arange(len(values)), round(SIDE / STEP)
    last = inner.shape[1] - 1
    within = inner[rows, np.clip(cut - side - BLURRED, 0, last)]
    beyond = outer[rows, np.clip(cut - side + BLURRED, 0, last)]
    across = within - beyond
    near = np.clip(cut[:, None] + np.arange(-side, side), 0, values.shape[1] - 1)
    level = ((values[rows[:, None], near] - beyond[:, None]) * across[:, None]).sum(-1)
    level = level / np.maximum((across**2).sum(-1), 1e-9)[:, None] - 0.5
    falls = (level[:, :-1] >= 0) & (level[:, 1:] < 0)
    drop = np.where(falls, level[:, :-1] - level[:, 1:], 1)
    # Sample `side` of `near` begins the outer side; a cut lies half a sample before it.
    where = np.arange(2 * side - 1) + level[:, :-1] / drop - side + 0.5
    where = np.where(falls, where, np.inf)
    best = where[rows, np.abs(where).argmin(1)]
    return np.where(np.isfinite(best), best, 0.0)
