"""Bounding boxes around triangles, in trees: what lets a ray pass by most of them.

Each node of a tree has two children and knows their boxes; a leaf is a run of triangles. Trees are
built from the top by the surface area heuristic over 16 bins (Wald 2007, "On fast Construction of
SAH-based Bounding Volume Hierarchies").
"""

from typing import NamedTuple

import numba
import numpy as np

LEAF = 4
"""Triangles of a leaf, at most; their number is kept in three bits."""
_BINS = 16
_NOTHING = np.float32(1e30)


class Trees(NamedTuple):
    """Trees over runs of triangles, their nodes one after the other."""

    boxes: np.ndarray
    """Corners of both children's boxes, lower and upper each, float32 [nodes, 2, 2, 3]."""
    children: np.ndarray
    """Of each child its node's number, or a leaf's `-1 - (8 * first + count)`, int32 [nodes, 2]."""
    order: np.ndarray
    """Numbers of the triangles as the leaves have them, int32 [triangles]."""
    roots: np.ndarray
    """Node of each tree that has the whole tree for its first child, int32 [trees]."""


def plant(corners: np.ndarray, counts: np.ndarray) -> Trees:
    """Builds a tree over each of several runs of triangles.

    Args:
        corners: Of the triangles, float32 [triangles, 3, 3].
        counts: Triangles of each run, one after the other; at least one each.
    """
    size = len(corners)
    lower, upper = corners.min(1), corners.max(1)
    boxes = np.empty((2 * size + len(counts), 2, 2, 3), np.float32)
    boxes[:, :, 0], boxes[:, :, 1] = _NOTHING, -_NOTHING
    children = np.full((len(boxes), 2), -1, np.int32)
    order, roots, used = np.arange(size, dtype=np.int32), [], 0
    firsts = np.cumsum(counts) - counts
    for first, count in zip(firsts, counts, strict=True):
        roots.append(used)
        used = _grow(lower, upper, order, (int(first), int(count), used), boxes, children)
    return Trees(boxes[:used], children[:used], order, np.array(roots, np.int32))


@numba.njit(cache=True)
def _grow(
    lower: np.ndarray,
    upper: np.ndarray,
    order: np.ndarray,
    run: tuple[int, int, int],
    boxes: np.ndarray,
    children: np.ndarray,
) -> int:
    """Builds the tree of a run (first, count, root); returns the number of nodes used by then."""
    first, count, root = run
    used = root + 1
    work = [(first, first + count, root, 0)]
    while len(work) > 0:
        begin, end, parent, side = work.pop()
        low, high = boxes[parent, side, 0], boxes[parent, side, 1]
        for i in range(begin, end):
            for k in range(3):
                low[k] = min(low[k], lower[order[i], k])
                high[k] = max(high[k], upper[order[i], k])
        if end - begin <= LEAF:
            children[parent, side] = -1 - (8 * begin + end - begin)
            continue
        middle = _split(lower, upper, order, begin, end)
        children[parent, side] = used
        work.append((begin, middle, used, 0))
        work.append((middle, end, used, 1))
        used += 1
    return used


@numba.njit(cache=True)
def _split(lower: np.ndarray, upper: np.ndarray, order: np.ndarray, begin: int, end: int) -> int:
    """Sorts a run's triangles to the two sides of the best plane; where the second side begins."""
    low, high = np.full(3, 1e30), np.full(3, -1e30)
    for i in range(begin, end):
        for k in range(3):
            centre = lower[order[i], k] + upper[order[i], k]
            low[k], high[k] = min(low[k], centre), max(high[k], centre)
    best, axis, cut = 1e30, -1, 0
    for k in range(3):
        if high[k] - low[k] > 1e-9:
            cost, where = _best_cut(lower, upper, order[begin:end], k, (low[k], high[k]))
            if cost < best:
                best, axis, cut = cost, k, where
    if axis < 0:  # all in one place
        return (begin + end) // 2
    scale = _BINS / (high[axis] - low[axis])
    i, j = begin, end
    while i < j:
        centre = lower[order[i], axis] + upper[order[i], axis]
        if min(_BINS - 1, int((centre - low[axis]) * scale)) < cut:
            i += 1
        else:
            j -= 1
            order[i], order[j] = order[j], order[i]
    return i


@numba.njit(cache=True)
def _best_cut(
    lower: np.ndarray, upper: np.ndarray, run: np.ndarray, axis: int, ends: tuple[float, float]
) -> tuple[float, int]:
    """Least cost of a plane across an axis, and the bin that begins behind that plane."""
    counts = np.zeros(_BINS, np.int64)
    low, high = np.full((_BINS, 3), 1e30), np.full((_BINS, 3), -1e30)
    scale = _BINS / (ends[1] - ends[0])
    for i in run:
        b = min(_BINS - 1, int((lower[i, axis] + upper[i, axis] - ends[0]) * scale))
        counts[b] += 1
        for k in range(3):
            low[b, k] = min(low[b, k], lower[i, k])
            high[b, k] = max(high[b, k], upper[i, k])
    costs = np.zeros(_BINS)
    for backwards in (False, True):
        number, a, b = 0, np.full(3, 1e30), np.full(3, -1e30)
        for step in range(_BINS - 1):
            at = _BINS - 1 - step if backwards else step
            number += counts[at]
            for k in range(3):
                a[k], b[k] = min(a[k], low[at, k]), max(b[k], high[at, k])
            x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
            area = x * y + y * z + z * x if number > 0 else 0.0
            # A plane before bin c has the bins below c on its first side.
            costs[at if backwards else at + 1] += number * area if number > 0 else 1e30
    where = 1 + int(np.argmin(costs[1:]))
    return costs[where], where
