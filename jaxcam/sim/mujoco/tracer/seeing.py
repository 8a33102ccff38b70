"""What each pixel of a picture sees, looked for solid by solid."""

import numpy as np

from jaxcam.sim.mujoco.tracer.geometry import BOX, MESH, PLANE, Solids
from jaxcam.sim.mujoco.tracer.kernel import (
    FAR,
    HALF,
    ONE,
    ZERO,
    Hits,
    Posed,
    Vector,
    back,
    closer,
    compiled,
    nearest,
    simple,
    turned,
)

_NEAR = np.float32(0.01)
"""Solids that come nearer to the camera's plane (m) are looked for in the whole picture."""


@compiled
def bounds(solids: Solids, s: int, size: np.ndarray) -> tuple[Vector, Vector]:
    """Half of a solid's box and the box's middle, in its own frame; 0 for planes."""
    kind = solids.kind[s]
    if kind == MESH:
        a, b = solids.lower[s], solids.upper[s]
        return (
            ((b[0] - a[0]) * HALF, (b[1] - a[1]) * HALF, (b[2] - a[2]) * HALF),
            ((a[0] + b[0]) * HALF, (a[1] + b[1]) * HALF, (a[2] + b[2]) * HALF),
        )
    middle = (ZERO, ZERO, ZERO)
    if kind == PLANE:
        return middle, middle
    if kind == BOX:
        return (size[0], size[1], size[2]), middle
    return (size[0], size[0], size[1]), middle


@compiled
def _window(
    solids: Solids, s: int, posed: Posed, shape: tuple[int, int]
) -> tuple[int, int, int, int]:
    """Rows and columns of the picture in which a solid can be seen: first, end, first, end."""
    height, width = shape
    geom = solids.geom[s]
    if solids.kind[s] == PLANE:
        return 0, height, 0, width
    rotation = posed.rotations[geom]
    half, middle = bounds(solids, s, posed.sizes[geom])
    left, right, top, bottom = FAR, -FAR, FAR, -FAR
    fx, fy, mx, my = posed.intrinsics
    for corner in range(8):
        local = (
            middle[0] + (half[0] if corner & 1 else -half[0]),
            middle[1] + (half[1] if corner & 2 else -half[1]),
            middle[2] + (half[2] if corner & 4 else -half[2]),
        )
        x, y, z = back(rotation, local)
        x, y, z = turned(
            posed.axes,
            x + posed.positions[geom, 0] - posed.eye[0],
            y + posed.positions[geom, 1] - posed.eye[1],
            z + posed.positions[geom, 2] - posed.eye[2],
        )
        if -z < _NEAR:
            return 0, height, 0, width
        column = np.float32(width) * HALF - mx - fx * x / z
        row = np.float32(height) * HALF - my + fy * y / z
        left, right = min(left, column), max(right, column)
        top, bottom = min(top, row), max(bottom, row)
    return (
        max(0, int(min(max(top, -ONE), np.float32(height)) - ONE)),
        min(height, int(max(min(bottom, np.float32(height)), -ONE) + ONE + ONE)),
        max(0, int(min(max(left, -ONE), np.float32(width)) - ONE)),
        min(width, int(max(min(right, np.float32(width)), -ONE) + ONE + ONE)),
    )


@compiled
def direction(posed: Posed, shape: tuple[int, int], i: int, j: int) -> Vector:
    """Of a pixel's ray, in the camera's axes."""
    fx, fy, mx, my = posed.intrinsics
    x = (np.float32(j) + HALF + mx - np.float32(shape[1]) * HALF) / fx
    return x, (np.float32(shape[0]) * HALF - my - HALF - np.float32(i)) / fy, -ONE


@compiled
def see(solids: Solids, posed: Posed, hits: Hits) -> None:
    """Finds what each pixel sees, one solid after the other."""
    height, width = hits.distance.shape
    for i in range(height):
        for j in range(width):
            hits.distance[i, j], hits.geom[i, j], hits.solid[i, j] = posed.reach, -1, -1
    _sort(solids, posed, hits.order, hits.away)
    for n in range(len(hits.order)):
        s = hits.order[n]
        geom, kind = solids.geom[s], solids.kind[s]
        rotation = posed.rotations[geom]
        origin = turned(
            rotation,
            posed.eye[0] - posed.positions[geom, 0],
            posed.eye[1] - posed.positions[geom, 1],
            posed.eye[2] - posed.positions[geom, 2],
        )
        first, last, begin, end = _window(solids, s, posed, (height, width))
        for i in range(first, last):
            for j in range(begin, end):
                wx, wy, wz = back(posed.axes, direction(posed, (height, width), i, j))
                ray = turned(rotation, wx, wy, wz)
                best = (hits.distance[i, j], hits.geom[i, j])
                if kind == MESH:
                    t, part, triangle, u, v = nearest(
                        solids, s, (origin, ray), best, (hits.nodes, hits.entries)
                    )
                    if triangle >= 0:
                        hits.distance[i, j], hits.geom[i, j] = t, part
                        hits.solid[i, j], hits.triangle[i, j] = s, triangle
                        hits.where[i, j, 0], hits.where[i, j, 1] = u, v
                    continue
                t, nx, ny, nz = simple(kind, posed.sizes[geom], origin, ray)
                if t >= ZERO and closer(t, geom, best[0], best[1]):
                    hits.distance[i, j], hits.geom[i, j], hits.solid[i, j] = t, geom, s
                    where = hits.where[i, j]
                    where[0], where[1], where[2] = nx, ny, nz


@compiled
def _sort(solids: Solids, posed: Posed, order: np.ndarray, away: np.ndarray) -> None:
    """Writes the solids' numbers by their middles' distances from the camera, planes last."""
    for s in range(len(solids.kind)):
        geom = solids.geom[s]
        _, middle = bounds(solids, s, posed.sizes[geom])
        x, y, z = back(posed.rotations[geom], middle)
        x += posed.positions[geom, 0] - posed.eye[0]
        y += posed.positions[geom, 1] - posed.eye[1]
        z += posed.positions[geom, 2] - posed.eye[2]
        far = FAR if solids.kind[s] == PLANE else x * x + y * y + z * z
        at = s
        while at > 0 and away[at - 1] > far:
            away[at], order[at] = away[at - 1], order[at - 1]
            at -= 1
        away[at], order[at] = far, s
