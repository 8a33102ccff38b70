"""The arm's surface as it is projected: samples that fill its silhouette, and its contour.

A contour in a picture is made of edges between a face that is seen from the front and one that is
seen from behind, where nothing else of the arm lies beyond them. Each of its points is a point of
a link, so that it is known where it goes when the camera, or a joint, moves.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from scipy.spatial import cKDTree

from jaxcam.robot.calibration.arm.model import LinkSurface
from jaxcam.robot.calibration.projection import placed

BEYOND = 2.0
"""Pixels beyond a contour at which nothing of the arm may be."""
WALL, ALIKE = 0.4, 0.8
"""Pixels from which on another contour is beyond a point, and the cosine of how alike they run."""
PIECES = 100
"""Into so many an edge is cut at most."""
CLOSED = 3
"""Pixels of the holes between samples that are closed."""


@dataclass(frozen=True)
class Surface:
    """The surfaces of all parts."""

    parts: Sequence[LinkSurface] = field(repr=False)
    normals: Sequence[np.ndarray] = field(repr=False)
    """Of each part's faces, [m, 3]."""
    edges: Sequence[np.ndarray] = field(repr=False)
    """Of each part: two vertices, and the faces on both sides (twice the same at a rim), [e, 4]."""

    @classmethod
    def of(cls, parts: Sequence[LinkSurface]) -> "Surface":
        """The surfaces of parts."""
        normals, edges = [], []
        for part in parts:
            a, b, c = (part.vertices[part.faces[:, i]] for i in range(3))
            across = np.cross(b - a, c - a)
            length = np.linalg.norm(across, axis=-1, keepdims=True)
            normals.append(across / np.maximum(length, 1e-15))
            edges.append(_edges(part.faces))
        return cls(parts, normals, edges)

    def samples(self, spacing: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Points spread over the surface.

        Args:
            spacing: Between neighbours, about (m).
            seed: Of the draw.

        Returns:
            The points in their links' axes [n, 3], and the parts they are of [n].
        """
        rng, points, owners = np.random.default_rng(seed), [], []
        for number, part in enumerate(self.parts):
            a, b, c = (part.vertices[part.faces[:, i]] for i in range(3))
            area = np.linalg.norm(np.cross(b - a, c - a), axis=-1) / 2
            count = max(int(2 * area.sum() / spacing**2), 8)
            # Evenly along the faces' summed areas: neighbours in the list are neighbours in space.
            at = (np.arange(count) + rng.random(count)) / count * area.sum()
            face = np.minimum(np.searchsorted(np.cumsum(area), at), len(area) - 1)
            u, v = np.sqrt(rng.random(count)), rng.random(count)
            weights = np.stack([1 - u, u * (1 - v), u * v], -1)
            corners = np.stack([a[face], b[face], c[face]], 1)
            points.append((weights[..., None] * corners).sum(1))
            owners.append(np.full(count, number))
        return np.concatenate(points), np.concatenate(owners)


def _edges(faces: np.ndarray) -> np.ndarray:
    """Edges of triangles with the faces on both sides, [e, 4]."""
    ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), 1)
    owner = np.repeat(np.arange(len(faces)), 3)
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    ends, owner = ends[order], owner[order]
    new = np.r_[True, (np.diff(ends, axis=0) != 0).any(1)]
    first = np.flatnonzero(new)
    count = np.diff(np.r_[first, len(ends)])
    second = np.where(count > 1, first + 1, first)
    return np.concatenate([ends[first], owner[first][:, None], owner[second][:, None]], 1)


def silhouette(pixels: np.ndarray, size: tuple[int, int], closed: int = CLOSED) -> np.ndarray:
    """The silhouette that samples fill, bool [h, w].

    Args:
        pixels: Of the samples, [n, 2]; not finite where they cannot be seen.
        size: Width and height.
        closed: Pixels of the holes between samples.
    """
    mask = np.zeros((size[1], size[0]), np.uint8)
    with np.errstate(invalid="ignore"):
        inside = ((pixels >= 0) & (pixels < size)).all(-1)
    x, y = pixels[inside].astype(int).T
    mask[y, x] = 1
    return cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((closed, closed), np.uint8)) > 0


@dataclass(frozen=True)
class Contour:
    """Points of a picture's contour."""

    points: np.ndarray = field(repr=False)
    """In their links' axes, [n, 3]."""
    owners: np.ndarray = field(repr=False)
    """The parts they are of, [n]."""
    pixels: np.ndarray = field(repr=False)
    """[n, 2]."""
    normals: np.ndarray = field(repr=False)
    """Outwards in the picture, of length one, [n, 2]."""


def contour(
    surface: Surface,
    camera_from_part: np.ndarray,
    K: np.ndarray,
    mask: np.ndarray,
    *,
    spacing: float = 2.0,
) -> Contour:
    """The contour of the arm in one picture.

    Args:
        surface: The arm's.
        camera_from_part: Poses of the parts before the camera, [parts, 4, 4].
        K: Of the picture (pixels).
        mask: The arm's silhouette there, bool [h, w].
        spacing: Between points, about (pixels).
    """
    points, owners, pixels, normals = [], [], [], []
    for number, part in enumerate(surface.parts):
        pose = camera_from_part[number]
        eye = -pose[:3, :3].T @ pose[:3, 3]
        facing = ((eye - part.vertices[part.faces[:, 0]]) * surface.normals[number]).sum(-1) > 0
        edges = surface.edges[number]
        rim = edges[:, 2] == edges[:, 3]
        edges = edges[(facing[edges[:, 2]] != facing[edges[:, 3]]) | rim]
        ends = part.vertices[edges[:, :2]]
        there = placed(pose, ends)
        ahead = (there[..., 2] > 0.05).all(1)
        ends, there = ends[ahead], there[ahead]
        flat = there[..., :2] / there[..., 2:]
        flat = flat @ K[:2, :2].T + K[:2, 2]
        length = np.linalg.norm(flat[:, 1] - flat[:, 0], axis=-1)
        ends, along = _pieces(ends, np.minimum(np.ceil(length / spacing), PIECES).astype(int))
        middle, ahead = placed(pose, ends), placed(pose, ends + along)
        middle, ahead = (p[:, :2] / p[:, 2:] @ K[:2, :2].T + K[:2, 2] for p in (middle, ahead))
        way = ahead - middle
        length = np.linalg.norm(way, axis=-1)
        normal = np.stack([way[:, 1], -way[:, 0]], -1) / np.maximum(length, 1e-9)[:, None]
        out, back = (_at(mask, middle + side * BEYOND * normal) for side in (1, -1))
        edge = (out != back) & (length > 1e-9)
        points.append(ends[edge])
        owners.append(np.full(int(edge.sum()), number))
        pixels.append(middle[edge])
        normals.append(np.where(out[edge], -1, 1)[:, None] * normal[edge])
    outline = Contour(*map(np.concatenate, (points, owners, pixels, normals)))
    return _thinned(outline, (mask.shape[1], mask.shape[0]), spacing)


def _pieces(ends: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middles of the pieces of edges [e, 2, 3] that are cut into so many, and ways along them."""
    counts = np.maximum(counts, 1)
    edge = np.repeat(np.arange(len(ends)), counts)
    number = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)
    along = (ends[edge, 1] - ends[edge, 0]) / counts[edge, None]
    return ends[edge, 0] + (number[:, None] + 0.5) * along, 0.1 * along


def _at(mask: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Values of a mask at pixels [n, 2]; false outside it."""
    h, w = mask.shape
    x, y = np.floor(np.clip(pixels, -1, 1e6)).astype(int).T
    inside = (x >= 0) & (x < w) & (y >= 0) & (y < h)
    return inside & mask[np.clip(y, 0, h - 1), np.clip(x, 0, w - 1)]


def _thinned(outline: Contour, size: tuple[int, int], spacing: float) -> Contour:
    """One point in each cell of the picture and direction, with nothing of the contour beyond it.

    Meshes have walls within walls, whose contours lie a little inside of what is seen.
    """
    inside = ((outline.pixels > 1) & (outline.pixels < np.array(size) - 1)).all(-1)
    cell = np.floor(outline.pixels / spacing).astype(int)
    turn = np.floor(np.arctan2(outline.normals[:, 1], outline.normals[:, 0]) / (np.pi / 4)).astype(
        int
    )
    keys = np.c_[cell, turn]
    outwards = (outline.pixels * outline.normals).sum(-1)
    order = np.flatnonzero(inside)
    order = order[np.argsort(-outwards[order], kind="stable")]
    _, first = np.unique(keys[order], axis=0, return_index=True)
    keep = np.sort(order[first])
    keep = keep[~_surpassed(outline.pixels[keep], outline.normals[keep], spacing)]
    return Contour(
        outline.points[keep], outline.owners[keep], outline.pixels[keep], outline.normals[keep]
    )


def _surpassed(pixels: np.ndarray, normals: np.ndarray, spacing: float) -> np.ndarray:
    """Which points [n, 2] have another, of about their direction, right beyond them; bool [n]."""
    result = np.zeros(len(pixels), bool)
    if len(pixels):
        pairs = cKDTree(pixels).query_pairs(np.hypot(BEYOND, spacing / 2), output_type="ndarray")
        pairs = np.concatenate([pairs, pairs[:, ::-1]])
        one, other = pairs.T
        way = pixels[other] - pixels[one]
        out = (way * normals[one]).sum(-1)
        aside = np.abs(way[:, 0] * normals[one, 1] - way[:, 1] * normals[one, 0])
        alike = (normals[one] * normals[other]).sum(-1) > ALIKE
        result[one[alike & (out > WALL) & (aside < spacing / 2)]] = True
    return result
