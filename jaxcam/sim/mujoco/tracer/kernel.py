"""Rays against meshes and simple solids: compiled by Numba, without the GIL, in float32.

Camera rays are not normalised: they advance by one along the camera's axis, so that the distance
along a ray is the planar depth. What is computed, in which order and with which tolerances is as in
MuJoCo Warp's `render.py`, which MJX draws with, so that the pictures of the two agree.
"""

import math
from typing import Any, NamedTuple

import numba
import numpy as np

from jaxcam.sim.mujoco.tracer.geometry import BOX, PLANE, Solids

ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)
FAR = np.float32(1e30)
_TINY = np.float32(1e-20)
_CLOSE = np.float32(1e-6)
"""Share of the distance within which two surfaces are in one place; the later geom is then seen."""
_RIM = np.float32(1e-4)
"""By what share of its edges a triangle is larger than it is: rays find no gap between two."""
_WIDER = np.float32(1.00001)
"""Boxes are taken for so much longer along a ray: rounding loses no triangle."""
STACK = 128
"""Room for the nodes that a ray has still to visit; trees are less deep by far."""

Vector = tuple[Any, Any, Any]
Strike = tuple[Any, Any, Any, Any]
# Without Numba's memory management: counting references took half of the time. So nothing is
# allocated here. What takes many arrays is inlined: to hand them over takes as long as to use them.
_OPTIONS: dict[str, Any] = {
    "nogil": True, "fastmath": True, "error_model": "numpy", "_nrt": False,
}  # fmt: skip
compiled = numba.njit(**_OPTIONS)
inlined = numba.njit(**_OPTIONS, inline="always")


class Posed(NamedTuple):
    """A world and its camera, float32."""

    positions: np.ndarray
    """Of geoms [geoms, 3]."""
    rotations: np.ndarray
    """Of geoms [geoms, 3, 3]."""
    sizes: np.ndarray
    """Of geoms [geoms, 3]."""
    eye: np.ndarray
    """[3]."""
    axes: np.ndarray
    """Of the camera, x to the right, y up, z backwards [3, 3]."""
    intrinsics: np.ndarray
    """Focal lengths, and from the principal point to the picture's middle [4]."""
    lights: np.ndarray
    """Directions of the lights [lights, 3]."""
    reach: np.float32
    """Planar depth up to which the camera sees."""


class Hits(NamedTuple):
    """What each pixel sees, and room to look for it."""

    distance: np.ndarray
    """Planar depth, float32 [H, W]."""
    solid: np.ndarray
    """Which solid, -1 for none, int32 [H, W]."""
    geom: np.ndarray
    """Which geom of it, int32 [H, W]."""
    triangle: np.ndarray
    """Which triangle, of a mesh, int32 [H, W]."""
    where: np.ndarray
    """Place on the triangle (weights of its second and third corner), or the normal of a simple
    solid, in the solid's frame, float32 [H, W, 3]."""
    nodes: np.ndarray
    """int32 [STACK]."""
    entries: np.ndarray
    """float32 [STACK]."""
    order: np.ndarray
    """Numbers of the solids as they are looked at, int32 [S]."""
    away: np.ndarray
    """Squares of their distances, float32 [S]."""
    light: np.ndarray
    """A pixel's colour without light, and with it, float32 [2, 3]."""


@compiled
def turned(matrix: np.ndarray, x: float, y: float, z: float) -> Vector:
    """`matrix.T @ (x, y, z)`."""
    return (
        matrix[0, 0] * x + matrix[1, 0] * y + matrix[2, 0] * z,
        matrix[0, 1] * x + matrix[1, 1] * y + matrix[2, 1] * z,
        matrix[0, 2] * x + matrix[1, 2] * y + matrix[2, 2] * z,
    )


@compiled
def back(matrix: np.ndarray, v: Vector) -> Vector:
    """`matrix @ v`."""
    return (
        matrix[0, 0] * v[0] + matrix[0, 1] * v[1] + matrix[0, 2] * v[2],
        matrix[1, 0] * v[0] + matrix[1, 1] * v[1] + matrix[1, 2] * v[2],
        matrix[2, 0] * v[0] + matrix[2, 1] * v[1] + matrix[2, 2] * v[2],
    )


@compiled
def _inverse(x: float) -> Any:
    return ONE / x if abs(x) > _TINY else (FAR if x >= ZERO else -FAR)


@compiled
def _enter(
    boxes: np.ndarray, node: int, side: int, origin: Vector, inverse: Vector
) -> tuple[Any, Any]:
    """Distances at which a ray enters and leaves a child's box."""
    enter, leave = ZERO, FAR
    for k in range(3):
        a = (boxes[node, side, 0, k] - origin[k]) * inverse[k]
        b = (boxes[node, side, 1, k] - origin[k]) * inverse[k]
        near, far = (a, b) if a < b else (b, a)
        enter = near if near > enter else enter
        leave = far if far < leave else leave
    return enter, leave * _WIDER


@compiled
def _triangle(triangles: np.ndarray, i: int, origin: Vector, ray: Vector) -> Strike:
    """Distance to a triangle and the place on it; the distance is negative behind and beside it.

    Seen from behind its determinant is negative.
    """
    ax, ay, az = triangles[i, 3], triangles[i, 4], triangles[i, 5]
    bx, by, bz = triangles[i, 6], triangles[i, 7], triangles[i, 8]
    px, py, pz = (
        ray[1] * bz - ray[2] * by,
        ray[2] * bx - ray[0] * bz,
        ray[0] * by - ray[1] * bx,
    )
    determinant = ax * px + ay * py + az * pz
    scale = _inverse(determinant)
    x, y, z = (
        origin[0] - triangles[i, 0],
        origin[1] - triangles[i, 1],
        origin[2] - triangles[i, 2],
    )
    u = (x * px + y * py + z * pz) * scale
    if u < -_RIM or u > ONE + _RIM:
        return -ONE, ZERO, ZERO, determinant
    qx, qy, qz = y * az - z * ay, z * ax - x * az, x * ay - y * ax
    v = (ray[0] * qx + ray[1] * qy + ray[2] * qz) * scale
    if v < -_RIM or u + v > ONE + _RIM:
        return -ONE, ZERO, ZERO, determinant
    return (bx * qx + by * qy + bz * qz) * scale, u, v, determinant


@compiled
def closer(distance: float, geom: Any, best: float, best_geom: int) -> Any:
    """Whether a surface hides the one found so far; of two in one place the later geom does."""
    margin = _CLOSE * best
    return distance < best - margin or (distance <= best + margin and geom > best_geom)


@inlined
def nearest(
    solids: Solids,
    s: int,
    ray: tuple[Vector, Vector],
    best: tuple[float, int],
    room: tuple[np.ndarray, np.ndarray],
) -> tuple[Any, ...]:
    """The nearest front face of a mesh before `best`: (distance, geom), triangle, u, v.

    Args:
        solids: All solids.
        s: Which one.
        ray: Origin and direction in its frame.
        best: Distance and geom of what was found so far.
        room: Nodes and entries to be visited.
    """
    origin, direction = ray
    inverse = (_inverse(direction[0]), _inverse(direction[1]), _inverse(direction[2]))
    distance, geom = best
    triangle, bu, bv = np.int32(-1), ZERO, ZERO
    nodes, entries = room
    top, node = 0, solids.root[s]
    while True:
        if node >= 0:
            one, one_end = _enter(solids.boxes, node, 0, origin, inverse)
            two, two_end = _enter(solids.boxes, node, 1, origin, inverse)
            limit = distance * _WIDER
            first = one <= one_end and one <= limit
            second = two <= two_end and two <= limit
            if first and second:
                later = 1 if one <= two else 0
                nodes[top] = solids.children[node, later]
                entries[top] = two if later == 1 else one
                top += 1
                node = solids.children[node, 1 - later]
                continue
            if first or second:
                node = solids.children[node, 0 if first else 1]
                continue
        else:
            leaf = -1 - node
            for i in range(leaf >> 3, (leaf >> 3) + (leaf & 7)):
                t, u, v, determinant = _triangle(solids.triangles, i, origin, direction)
                front = t >= ZERO and determinant > ZERO
                if front and closer(t, solids.part[i], distance, geom):
                    distance, geom, triangle, bu, bv = t, solids.part[i], np.int32(i), u, v
        while True:
            if top == 0:
                return distance, geom, triangle, bu, bv
            top -= 1
            if entries[top] <= distance * _WIDER:
                node = nodes[top]
                break


@inlined
def meets_mesh(
    solids: Solids, s: int, origin: Vector, direction: Vector, nodes: np.ndarray
) -> bool:
    """Whether a ray meets a mesh at all, from either side."""
    inverse = (_inverse(direction[0]), _inverse(direction[1]), _inverse(direction[2]))
    top, node = 0, solids.root[s]
    while True:
        if node >= 0:
            one, one_end = _enter(solids.boxes, node, 0, origin, inverse)
            two, two_end = _enter(solids.boxes, node, 1, origin, inverse)
            first, second = one <= one_end, two <= two_end
            if first and second:
                nodes[top] = solids.children[node, 1]
                top += 1
            if first or second:
                node = solids.children[node, 0 if first else 1]
                continue
        else:
            leaf = -1 - node
            for i in range(leaf >> 3, (leaf >> 3) + (leaf & 7)):
                t, _, _, _ = _triangle(solids.triangles, i, origin, direction)
                if t >= ZERO:
                    return True
        if top == 0:
            return False
        top -= 1
        node = nodes[top]


@compiled
def simple(kind: Any, size: np.ndarray, origin: Vector, ray: Vector) -> Strike:
    """Distance at which a ray enters a plane, box or cylinder, negative if never; the normal."""
    if kind == PLANE:
        if ray[2] >= ZERO:
            return -ONE, ZERO, ZERO, ONE
        t = -origin[2] / ray[2]
        x, y = origin[0] + t * ray[0], origin[1] + t * ray[1]
        beside = (size[0] > ZERO and abs(x) > size[0]) or (size[1] > ZERO and abs(y) > size[1])
        return -ONE if beside else t, ZERO, ZERO, ONE
    enter, leave, axis = -FAR, FAR, 0
    for k in range(3):
        if kind == BOX or k == 2:
            half = size[k] if kind == BOX else size[1]
            scale = _inverse(ray[k])
            a, b = (-half - origin[k]) * scale, (half - origin[k]) * scale
            near, far = (a, b) if a < b else (b, a)
            axis = k if near > enter else axis
            enter, leave = max(near, enter), min(far, leave)
    if kind == BOX:
        if enter > leave:
            return -ONE, ZERO, ZERO, ONE
        sign = -ONE if ray[axis] > ZERO else ONE
        return (
            enter,
            sign if axis == 0 else ZERO,
            sign if axis == 1 else ZERO,
            sign if axis == 2 else ZERO,
        )
    a = ray[0] * ray[0] + ray[1] * ray[1]
    b = ray[0] * origin[0] + ray[1] * origin[1]
    c = origin[0] * origin[0] + origin[1] * origin[1] - size[0] * size[0]
    if a < _TINY:
        miss = c > ZERO or enter > leave
        return -ONE if miss else enter, ZERO, ZERO, -ONE if ray[2] > ZERO else ONE
    under = b * b - a * c
    if under < ZERO:
        return -ONE, ZERO, ZERO, ONE
    root = math.sqrt(under)
    side = (-b - root) / a
    if max(side, enter) > min((-b + root) / a, leave):
        return -ONE, ZERO, ZERO, ONE
    if side < enter:
        return enter, ZERO, ZERO, -ONE if ray[2] > ZERO else ONE
    x, y = origin[0] + side * ray[0], origin[1] + side * ray[1]
    return side, x / size[0], y / size[0], ZERO
