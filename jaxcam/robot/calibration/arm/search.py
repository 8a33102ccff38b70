"""The coarse search: from which side, at all, the arm's motion was seen.

Between two pictures of an episode the arm leaves some places and comes to others: what changes is
the difference of its silhouettes. Thousands of poses around the robot are tried on coarse pictures
of such changes; the best are varied until none is better.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from jaxcam.rays import look_at
from jaxcam.robot.calibration.arm.film import Film
from jaxcam.robot.calibration.arm.model import ArmModel
from jaxcam.robot.calibration.arm.surface import Surface
from jaxcam.robot.calibration.projection import placed

CELLS = 32
"""Cells of a coarse picture along its longer side."""
CHANGED = 18.0
"""Levels (of 255) by which a pixel that changes does."""
TINT = 0.025
"""Change of a pixel's colour, whatever its brightness, beyond which it is no shadow."""
SHADE = 0.35
"""What a change counts that may be a shadow."""
PAIRS, IN_ALL = 2, 12
"""Pairs of pictures of an episode, and in all."""
SPACING = 0.035
"""Distance (m) between samples of the arm."""
AZIMUTHS, ELEVATIONS, DISTANCES = 30, (5, 20, 35, 50, 65, 80), (0.5, 0.7, 1.0, 1.4, 2.0, 2.8)
"""Sides, degrees above the horizon, and metres from the arm, that are tried."""
KEPT, ROUNDS, VARIED = 24, 7, 16
"""Poses that are kept, how often they are varied, and into how many each."""
SIDE = np.deg2rad(25)
"""Poses seen from the arm within this angle are of one side (rad)."""
AT_ONCE = 64
"""Poses that are tried at a time."""


@dataclass(frozen=True)
class Changes:
    """What changes between pictures, in coarse cells, and where the arm's surface then is."""

    seen: np.ndarray = field(repr=False)
    """Share of each cell that changes, [pairs, cells]."""
    points: np.ndarray = field(repr=False)
    """Of the arm in the base frame, float32 [2 pairs, n, 3]: all first pictures, then seconds."""
    grid: tuple[int, int]
    """Cells across and down."""
    cell: float
    """Pixels of a cell."""
    K: np.ndarray

    def fits(self, poses: np.ndarray) -> np.ndarray:
        """How well poses [h, 4, 4] explain what changes: overlap over union, [h]."""
        return np.concatenate([
            self._fits(poses[i : i + AT_ONCE]) for i in range(0, len(poses), AT_ONCE)
        ])  # fmt: skip

    def _fits(self, poses: np.ndarray) -> np.ndarray:
        inverse = np.linalg.inv(poses).astype(np.float32)
        count, (w, h) = len(poses), self.grid
        there = np.einsum("hij,tnj->ihtn", inverse[:, :3, :3], self.points, optimize=True)
        there += inverse[:, :3, 3].T[:, :, None, None]
        z = np.where(there[2] > 0.05, there[2], np.inf)
        u = (self.K[0, 0] * there[0] / z + self.K[0, 2]) / self.cell
        v = (self.K[1, 1] * there[1] / z + self.K[1, 2]) / self.cell
        inside = (u >= 0) & (u < w) & (v >= 0) & (v < h) & np.isfinite(z)
        times = self.points.shape[0]
        base = np.arange(count * times).reshape(count, times, 1) * (w * h)
        cells = (base + v.astype(np.int32) * w + u.astype(np.int32))[inside]
        masks = np.zeros(count * times * w * h, bool)
        masks[cells] = True
        masks = masks.reshape(count, 2, times // 2, w * h)
        changed = masks[:, 0] ^ masks[:, 1]
        both = np.einsum("hpc,pc->h", changed.astype(np.float32), self.seen, optimize=True)
        return both / (changed.sum((1, 2)) + self.seen.sum() - both + 1e-6)


def changes_of(arm: ArmModel, film: Film) -> Changes:
    """What changes between the pictures of each episode that are farthest apart."""
    pairs = [pair for rows in film.by_episode() for pair in _far_apart(film.angles[rows], rows)]
    way = [-float(np.linalg.norm(film.angles[a] - film.angles[b])) for a, b in pairs]
    pairs = [pairs[i] for i in sorted(np.argsort(way, kind="stable")[:IN_ALL])]
    first, second = np.array(pairs).T
    width, height = film.size
    cell = max(width, height) / CELLS
    grid = int(np.ceil(width / cell)), int(np.ceil(height / cell))
    seen = []
    for a, b in pairs:
        part = changed(film, a, b)
        whole = np.zeros((round(grid[1] * cell), round(grid[0] * cell)), np.float32)
        whole[:height, :width] = part[: whole.shape[0], : whole.shape[1]]
        seen.append(cv2.resize(whole, grid, interpolation=cv2.INTER_AREA).ravel())
    points, owners = Surface.of(arm.parts).samples(SPACING)
    poses = arm.poses(film.angles[np.r_[first, second]], _some(film.opening, first, second))
    where = np.stack([placed(row[owners], points[:, None])[:, 0] for row in poses])
    return Changes(np.stack(seen), where.astype(np.float32), grid, cell, film.K)


def changed(film: Film, a: int, b: int) -> np.ndarray:
    """How much each pixel changes between two pictures, from 0 to 1, [h, w]."""
    if film.masks is not None:
        return (film.masks[a] ^ film.masks[b]).astype(np.float32)
    one, other = (cv2.GaussianBlur(film.rgb[i].astype(np.float32), (0, 0), 1.0) for i in (a, b))
    differs = abs(one - other).max(-1) > CHANGED
    tints = [x / np.maximum(np.linalg.norm(x, axis=-1, keepdims=True), 20) for x in (one, other)]
    tint = np.linalg.norm(tints[0] - tints[1], axis=-1) > TINT
    return np.where(differs, np.where(tint, 1.0, SHADE), 0.0).astype(np.float32)


def _some(opening: np.ndarray | None, first: np.ndarray, second: np.ndarray) -> np.ndarray | None:
    return None if opening is None else opening[np.r_[first, second]]


def _far_apart(angles: np.ndarray, rows: np.ndarray) -> Iterator[tuple[int, int]]:
    """Pairs of pictures whose joints differ most, none twice in both."""
    far = np.linalg.norm(angles[:, None] - angles[None], axis=-1)
    for _ in range(PAIRS):
        a, b = np.unravel_index(far.argmax(), far.shape)
        if far[a, b] <= 0:
            return
        yield int(rows[a]), int(rows[b])
        far[[a, b]], far[:, [a, b]] = far[[a, b]] * 0.7, far[:, [a, b]] * 0.7
        far[a, b] = far[b, a] = 0


def search(changes: Changes, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """The poses that explain most, the best first.

    Args:
        changes: What changes in the pictures.
        seed: Of the variations.

    Returns:
        Poses [k, 4, 4], and how well they fit [k]; k is at most `KEPT`.
    """
    rng = np.random.default_rng(seed)
    poses = _around(changes)
    fits = changes.fits(poses)
    middle = changes.points.reshape(-1, 3).mean(0).astype(float)
    poses, fits = _best(poses, fits, middle)
    for round_ in range(ROUNDS):
        wide = 0.6**round_
        more = np.concatenate([_varied(pose, middle, wide, rng) for pose in poses])
        poses = np.concatenate([poses, more])
        fits = np.concatenate([fits, changes.fits(more)])
        poses, fits = _best(poses, fits, middle)
    return poses, fits


def _best(poses: np.ndarray, fits: np.ndarray, middle: np.ndarray) -> tuple[np.ndarray, ...]:
    """The poses that fit best, the best first; of one side of the arm at most a third."""
    ways = poses[:, :3, 3] - middle
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    kept: list[int] = []
    for i in np.argsort(-fits):
        if len(kept) == KEPT:
            break
        if not kept or (ways[kept] @ ways[i] > np.cos(SIDE)).sum() < KEPT // 3:
            kept.append(int(i))
    return poses[kept], fits[kept]


def _around(changes: Changes) -> np.ndarray:
    """Poses all around the arm, from which what moves is where something changes."""
    middle = changes.points.reshape(-1, 3).mean(0).astype(float)
    w, h = changes.grid
    y, x = np.divmod(np.arange(w * h), w)
    weights = changes.seen.sum(0)
    centre = np.array([(weights * (x + 0.5)).sum(), (weights * (y + 0.5)).sum()])
    centre = centre / max(weights.sum(), 1e-9) * changes.cell
    K = changes.K
    ray = np.array([(centre[0] - K[0, 2]) / K[0, 0], (centre[1] - K[1, 2]) / K[1, 1], 1.0])
    ahead = Rotation.align_vectors(ray / np.linalg.norm(ray), [0, 0, 1.0])[0].as_matrix()
    # Of all moving points, those that move most: the outer half.
    moves = np.ptp(changes.points, axis=0).sum(-1)
    middle = changes.points[:, moves > np.median(moves)].reshape(-1, 3).mean(0).astype(float)
    poses = []
    for azimuth in np.linspace(-np.pi, np.pi, AZIMUTHS, endpoint=False):
        for elevation in np.deg2rad(ELEVATIONS):
            flat = np.cos(elevation)
            way = np.array([np.cos(azimuth) * flat, np.sin(azimuth) * flat, np.sin(elevation)])
            for distance in DISTANCES:
                pose = np.asarray(look_at(middle + distance * way, middle), float)
                pose[:3, :3] = pose[:3, :3] @ ahead.T
                poses.append(pose)
    return np.stack(poses)


def _varied(
    pose: np.ndarray, middle: np.ndarray, wide: float, rng: np.random.Generator
) -> np.ndarray:
    """A pose, varied: turned about what it looks at, nearer or farther, and turned in itself."""
    poses = np.tile(pose, (VARIED, 1, 1))
    about = Rotation.from_rotvec(rng.normal(0, 0.15 * wide, (VARIED, 3))).as_matrix()
    own = Rotation.from_rotvec(rng.normal(0, 0.04 * wide, (VARIED, 3)) * [1, 1, 2]).as_matrix()
    scale = np.exp(rng.normal(0, 0.15 * wide, (VARIED, 1)))
    out = (pose[:3, 3] - middle) * scale
    poses[:, :3, 3] = middle + (about @ out[..., None])[..., 0]
    poses[:, :3, :3] = about @ pose[:3, :3] @ own
    return poses
