"""The light that pixels receive, computed as in MuJoCo Warp's `render.py`; see `kernel`."""

import math
from typing import NamedTuple

import numpy as np

from jaxcam.sim.mujoco.tracer.geometry import MESH, PLANE, Solids, Surfaces
from jaxcam.sim.mujoco.tracer.kernel import (
    FAR,
    HALF,
    ONE,
    ZERO,
    Hits,
    Posed,
    Vector,
    back,
    compiled,
    inlined,
    meets_mesh,
    simple,
    turned,
)
from jaxcam.sim.mujoco.tracer.seeing import bounds, direction

_FULL = np.float32(255)
_OFF = np.float32(1e-4)
"""How far off the surface (m) shadow rays begin."""
_SHADE = np.float32(0.3)
"""What is left of a light in its shadow; MJX's `shadow_light_fraction`."""


class Casters(NamedTuple):
    """What may stand between a point and each of the lights, which are far away."""

    axes: np.ndarray
    """Two axes across a light's direction, and the one towards it, float32 [lights, 3, 3]."""
    rays: np.ndarray
    """The direction towards a light in each solid's frame, float32 [lights, S, 3]."""
    ends: np.ndarray
    """Where each solid is along these axes: from and to, across; and to, along, float32
    [lights, S, 5]."""


@compiled
def _place_all(solids: Solids, posed: Posed, casters: Casters) -> None:
    """Writes what may stand between a point and the lights."""
    lights, count = len(posed.lights), len(solids.kind)
    for k in range(lights):
        x, y, z = -posed.lights[k, 0], -posed.lights[k, 1], -posed.lights[k, 2]
        across = (ZERO, -z, y) if abs(x) < HALF else (-y, x, ZERO)
        square = across[0] * across[0] + across[1] * across[1] + across[2] * across[2]
        scale = ONE / math.sqrt(square)
        ax, ay, az = across[0] * scale, across[1] * scale, across[2] * scale
        axes = casters.axes[k]
        axes[0, 0], axes[0, 1], axes[0, 2] = ax, ay, az
        axes[1, 0], axes[1, 1], axes[1, 2] = y * az - z * ay, z * ax - x * az, x * ay - y * ax
        axes[2, 0], axes[2, 1], axes[2, 2] = x, y, z
        for s in range(count):
            _place(solids, s, posed, axes, casters.rays[k, s], casters.ends[k, s])


@compiled
def _place(
    solids: Solids, s: int, posed: Posed, axes: np.ndarray, ray: np.ndarray, ends: np.ndarray
) -> None:
    """Writes the direction towards a light in a solid's frame, and where the solid is."""
    geom = solids.geom[s]
    rotation = posed.rotations[geom]
    ray[0], ray[1], ray[2] = turned(rotation, axes[2, 0], axes[2, 1], axes[2, 2])
    if solids.kind[s] == PLANE:
        ends[0], ends[1], ends[2], ends[3] = -FAR, FAR, -FAR, FAR
        ends[4] = -FAR if ray[2] >= ZERO else FAR
        return
    half, middle = bounds(solids, s, posed.sizes[geom])
    mx, my, mz = back(rotation, middle)
    mx += posed.positions[geom, 0]
    my += posed.positions[geom, 1]
    mz += posed.positions[geom, 2]
    for k in range(3):
        a, b, c = turned(rotation, axes[k, 0], axes[k, 1], axes[k, 2])
        reach = abs(a) * half[0] + abs(b) * half[1] + abs(c) * half[2] + _OFF
        at = axes[k, 0] * mx + axes[k, 1] * my + axes[k, 2] * mz
        if k < 2:
            ends[2 * k], ends[2 * k + 1] = at - reach, at + reach
        else:
            ends[4] = at + reach


@inlined
def _shadowed(
    solids: Solids, posed: Posed, casters: Casters, k: int, point: Vector, nodes: np.ndarray
) -> bool:
    """Whether anything stands between a point and light `k`."""
    axes, rays, ends = casters.axes[k], casters.rays[k], casters.ends[k]
    a = axes[0, 0] * point[0] + axes[0, 1] * point[1] + axes[0, 2] * point[2]
    b = axes[1, 0] * point[0] + axes[1, 1] * point[1] + axes[1, 2] * point[2]
    c = axes[2, 0] * point[0] + axes[2, 1] * point[1] + axes[2, 2] * point[2]
    for s in range(len(solids.kind)):
        if a < ends[s, 0] or a > ends[s, 1] or b < ends[s, 2] or b > ends[s, 3] or c > ends[s, 4]:
            continue
        geom, kind = solids.geom[s], solids.kind[s]
        origin = turned(
            posed.rotations[geom],
            point[0] - posed.positions[geom, 0],
            point[1] - posed.positions[geom, 1],
            point[2] - posed.positions[geom, 2],
        )
        ray = (rays[s, 0], rays[s, 1], rays[s, 2])
        if kind == MESH:
            if meets_mesh(solids, s, origin, ray, nodes):
                return True
        elif simple(kind, posed.sizes[geom], origin, ray)[0] >= ZERO:
            return True
    return False


@inlined
def _normal(
    solids: Solids, surfaces: Surfaces, rotation: np.ndarray, hits: Hits, at: tuple[int, int]
) -> Vector:
    """Unit normal in the world of what a pixel sees."""
    i, j = at
    where = hits.where[i, j]
    if solids.kind[hits.solid[i, j]] != MESH:
        return back(rotation, (where[0], where[1], where[2]))
    n = surfaces.normals[hits.triangle[i, j]]
    u, v = where[0], where[1]
    w = ONE - u - v
    x, y, z = back(
        rotation,
        (
            n[0] * w + n[3] * u + n[6] * v,
            n[1] * w + n[4] * u + n[7] * v,
            n[2] * w + n[5] * u + n[8] * v,
        ),
    )
    scale = ONE / math.sqrt(x * x + y * y + z * z)
    return x * scale, y * scale, z * scale


@inlined
def _light(
    solids: Solids,
    surfaces: Surfaces,
    posed: Posed,
    casters: Casters,
    hits: Hits,
    at: tuple[int, int],
) -> None:
    """Adds the light that a pixel receives to `hits.light`."""
    i, j = at
    geom, solid = hits.geom[i, j], solids.geom[hits.solid[i, j]]
    rx, ry, rz = back(posed.axes, direction(posed, hits.distance.shape, i, j))
    t = hits.distance[i, j]
    px, py, pz = posed.eye[0] + t * rx, posed.eye[1] + t * ry, posed.eye[2] + t * rz
    scale = -ONE / math.sqrt(rx * rx + ry * ry + rz * rz)
    vx, vy, vz = rx * scale, ry * scale, rz * scale
    rotation = posed.rotations[solid]
    nx, ny, nz = _normal(solids, surfaces, rotation, hits, at)
    _base(surfaces, geom, posed, (px, py, pz), hits.light)
    off = (px + nx * _OFF, py + ny * _OFF, pz + nz * _OFF)
    base, total = hits.light
    lights = len(surfaces.shadowing)
    for k in range(lights):
        if k == lights - 1:
            lx, ly, lz = posed.axes[0, 2], posed.axes[1, 2], posed.axes[2, 2]
        else:
            lx, ly, lz = -posed.lights[k, 0], -posed.lights[k, 1], -posed.lights[k, 2]
        facing = nx * lx + ny * ly + nz * lz
        if facing <= ZERO:
            continue
        left = ONE
        if surfaces.shadowing[k] and _shadowed(solids, posed, casters, k, off, hits.nodes):
            left = _SHADE
        hx, hy, hz = lx + vx, ly + vy, lz + vz
        length = math.sqrt(hx * hx + hy * hy + hz * hz)
        mirror = (nx * hx + ny * hy + nz * hz) / length
        gloss = ZERO
        bright = surfaces.highlight[k, 0] + surfaces.highlight[k, 1] + surfaces.highlight[k, 2]
        if mirror > surfaces.dull[geom] and bright > ZERO:
            gloss = surfaces.specular[geom] * mirror ** surfaces.exponent[geom] * left
        for c in range(3):
            total[c] += base[c] * surfaces.diffuse[k, c] * facing * left
            total[c] += surfaces.highlight[k, c] * gloss


@inlined
def _base(surfaces: Surfaces, geom: int, posed: Posed, point: Vector, light: np.ndarray) -> None:
    """Writes a point's own colour and what it sends in ambient light."""
    for c in range(3):
        light[0, c], light[1, c] = surfaces.colour[geom, c], surfaces.ambient[geom, c]
    if surfaces.repeat[geom, 0] > ZERO:
        x, y, _ = turned(
            posed.rotations[geom],
            point[0] - posed.positions[geom, 0],
            point[1] - posed.positions[geom, 1],
            point[2] - posed.positions[geom, 2],
        )
        _texture(surfaces.texture, surfaces.repeat[geom], posed.sizes[geom], (x, y), light)


@compiled
def _texture(
    texture: np.ndarray,
    repeat: np.ndarray,
    size: np.ndarray,
    place: tuple[float, float],
    light: np.ndarray,
) -> None:
    """Multiplies colours by a plane's texture at a place (m) of it, between its pixels."""
    x, y = place
    off = -HALF if size[0] <= ZERO or size[1] <= ZERO else ZERO
    u = HALF * x if size[0] <= ZERO else (x + size[0]) / (size[0] + size[0])
    v = -HALF * y if size[1] <= ZERO else (size[1] - y) / (size[1] + size[1])
    u, v = u * repeat[0] + off, v * repeat[1] + off
    height, width = texture.shape[:2]
    u = (u - np.float32(math.floor(u))) * np.float32(width) - HALF
    v = (v - np.float32(math.floor(v))) * np.float32(height) - HALF
    left, top = math.floor(u), math.floor(v)
    fu, fv = u - np.float32(left), v - np.float32(top)
    right, under = min(left + 1, width - 1), min(top + 1, height - 1)
    left, top = max(left, 0), max(top, 0)
    for c in range(3):
        upper = texture[top, left, c] * (ONE - fu) + texture[top, right, c] * fu
        lower = texture[under, left, c] * (ONE - fu) + texture[under, right, c] * fu
        texel = upper * (ONE - fv) + lower * fv
        light[0, c] *= texel
        light[1, c] *= texel


@compiled
def shade(
    solids: Solids,
    surfaces: Surfaces,
    posed: Posed,
    casters: Casters,
    hits: Hits,
    sky: np.ndarray,
    picture: np.ndarray,
) -> None:
    """Writes a picture, uint8 [H, W, 3], of what its pixels see."""
    height, width = hits.distance.shape
    _place_all(solids, posed, casters)
    for i in range(height):
        for j in range(width):
            if hits.solid[i, j] < 0:
                for c in range(3):
                    picture[i, j, c] = sky[c]
                continue
            _light(solids, surfaces, posed, casters, hits, (i, j))
            for c in range(3):
                value = min(max(hits.light[1, c], ZERO), ONE)
                picture[i, j, c] = np.uint8(value * _FULL)
