"""Fewer triangles that look alike: small pictures show few of a robot's 135,000.

Needs the extra `jaxcam[maniskill]`.
"""

import functools
from typing import Any, NamedTuple

import numpy as np
import pyfqmr
import trimesh

SHARES = 0.1, 0.2, 0.4
"""Of a mesh's triangles that stay: the first with which it keeps its area, else all stay."""
AREA = 0.0125
"""Share of its area by which a mesh may change."""
FEW = 300
"""Triangles of meshes that stay as they are."""
CAUTION = 3
"""How fast triangles are taken away (0 to 10); the faster, the more shapes suffer."""
CREASE = np.deg2rad(20)
"""Between triangles (rad) that is seen as an edge; others look like one round surface."""


class Mesh(NamedTuple):
    """What SAPIEN draws of a part."""

    vertices: np.ndarray
    """Metres [n, 3]."""
    triangles: np.ndarray
    """Numbers of vertices [m, 3]."""
    normals: np.ndarray
    """Of the vertices [n, 3]."""
    uvs: np.ndarray
    """Places in a texture [n, 2]."""


def fewer(mesh: Mesh, *, has_texture: bool) -> Mesh:
    """A mesh that looks like another and has fewer triangles.

    Rectangles get two; others a tenth to two fifths, unless they have few, carry a texture, or
    would change by more of their area than `AREA`.

    Args:
        mesh: With many triangles.
        has_texture: Whether it matters where in a texture its vertices are.
    """
    corners = _corners(mesh)
    if corners is not None:
        return corners
    if has_texture or len(mesh.triangles) <= FEW:
        return mesh
    light = _simplified(mesh.vertices.tobytes(), mesh.triangles.astype(np.int64).tobytes())
    return light or mesh


@functools.lru_cache(64)
def _simplified(vertices: bytes, triangles: bytes) -> Mesh | None:
    """A mesh with fewer triangles; None if none looks like it. Remembered: worlds have the same."""
    solid = trimesh.Trimesh(
        np.frombuffer(vertices, np.float32).reshape(-1, 3),
        np.frombuffer(triangles, np.int64).reshape(-1, 3),
    )
    for share in SHARES:
        many: Any = pyfqmr.Simplify()  # pyright: ignore[reportAttributeAccessIssue]
        many.setMesh(solid.vertices, solid.faces)
        many.simplify_mesh(
            target_count=int(share * len(solid.faces)),
            aggressiveness=CAUTION,
            preserve_border=True,
            verbose=False,
        )
        light = trimesh.Trimesh(*many.getMesh()[:2], process=False)
        if abs(light.area / solid.area - 1) <= AREA:
            break
    else:
        return None
    smooth = trimesh.graph.smooth_shade(light, angle=CREASE, facet_minarea=None)
    corners = np.asarray(smooth.vertices, np.float32)
    return Mesh(
        corners,
        np.asarray(smooth.faces, np.uint32),
        np.asarray(smooth.vertex_normals, np.float32),
        np.zeros((len(corners), 2), np.float32),
    )


def _corners(mesh: Mesh) -> Mesh | None:
    """Two triangles instead of a grid that fills a level rectangle evenly; None if it is none."""
    if not len(mesh.triangles):
        return None
    corners = mesh.vertices[mesh.triangles]
    low, high = corners.min((0, 1)), corners.max((0, 1))
    sides = np.diff(corners[..., :2], axis=1)
    areas = (sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]) / 2
    is_up = bool(areas[0] > 0)
    if low[2] != high[2] or ((areas > 0) != is_up).any() or not _covers(corners, low, high):
        return None
    if not np.isclose(abs(areas).sum(), np.prod(high[:2] - low[:2])):
        return None
    if not np.allclose(mesh.normals, mesh.normals[:1], atol=1e-5):
        return None
    planar = np.c_[mesh.vertices[:, :2], np.ones(len(mesh.vertices))].astype(float)
    uv_from_xy1 = np.linalg.lstsq(planar, mesh.uvs, rcond=None)[0]
    if not np.allclose(planar @ uv_from_xy1, mesh.uvs, atol=1e-5):
        return None
    x, y = np.stack([low, high], 1)[:2]
    corners = np.array([[x[i], y[j], low[2]] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))])
    return Mesh(
        corners.astype(np.float32),
        np.array([[0, 1, 2], [0, 2, 3]] if is_up else [[0, 2, 1], [0, 3, 2]], np.uint32),
        np.repeat(mesh.normals[:1], 4, 0),
        (np.c_[corners[:, :2], np.ones(4)] @ uv_from_xy1).astype(np.float32),
    )


def _covers(corners: np.ndarray, low: np.ndarray, high: np.ndarray) -> bool:
    """Whether all edges of triangles [m, 3, 3] but a rectangle's are between two of them each."""
    edges = np.stack([corners, np.roll(corners, -1, 1)], 2)[..., :2].reshape(-1, 2, 2)
    is_side = ((edges == low[:2]).all(1) | (edges == high[:2]).all(1)).any(1)
    there = edges[~is_side].reshape(-1, 4)
    back = there[:, [2, 3, 0, 1]]
    return np.array_equal(there[np.lexsort(there.T)], back[np.lexsort(back.T)])
