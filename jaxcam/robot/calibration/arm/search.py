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
AZIMUTHS, ELEVATIONS, DISTANCES = 24, (5, 22, 40, 58, 76), (0.5, 0.75, 1.1, 1.6, 2.4)
"""Sides, degrees above the horizon, and metres from the arm, that are tried."""
BEYOND = 0.7
"""How far beyond the middle of the changes what moves is also looked for, in shares of its way from
the picture's middle."""
SIDES, APART = 4, np.deg2rad(35)
"""Sides of the arm from which poses are improved, and the angle between them (rad)."""
ROUNDS, DRAWN, ELITE = 11, 64, 10
"""How often a pose is improved, by how many draws, and of those, the best."""
WIDE = (0.25, 0.25, 0.25, 0.12, 0.12, 0.2)
"""Spread of the first draws: of turns about the arm, pan and tilt (rad), and of the distance."""
FINE, FINER = 2.0, 0.5
"""Cells of the second search are so many times as fine, and its first draws spread so much less."""
LIKELY = 0.8
"""A side that explains less than this share of the best one is not searched again."""
AT_ONCE = 64
"""Poses that are tried at a time."""


@dataclass(frozen=True)
class MotionCells:
    """What changes between pictures, in coarse cells, and where the arm's surface then is."""

    share: np.ndarray = field(repr=False)
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
        both = np.einsum("hpc,pc->h", changed.astype(np.float32), self.share, optimize=True)
        return both / (changed.sum((1, 2)) + self.share.sum() - both + 1e-6)


def changes_of(arm: ArmModel, film: Film, fine: float = 1.0) -> MotionCells:
    """What changes between the pictures of each episode that are farthest apart.

    Args:
        arm: The robot.
        film: The pictures.
        fine: How many times as fine cells are than usual.
    """
    pairs = [pair for rows in film.by_episode() for pair in _far_apart(film.angles[rows], rows)]
    way = [-float(np.linalg.norm(film.angles[a] - film.angles[b])) for a, b in pairs]
    pairs = [pairs[i] for i in sorted(np.argsort(way, kind="stable")[:IN_ALL])]
    first, second = np.array(pairs).T
    width, height = film.size
    cell = max(width, height) / (CELLS * fine)
    grid = int(np.ceil(width / cell)), int(np.ceil(height / cell))
    share = []
    for a, b in pairs:
        part = changed(film, a, b)
        whole = np.zeros((round(grid[1] * cell), round(grid[0] * cell)), np.float32)
        whole[:height, :width] = part[: whole.shape[0], : whole.shape[1]]
        share.append(cv2.resize(whole, grid, interpolation=cv2.INTER_AREA).ravel())
    points, owners = Surface.of(arm.parts).samples(SPACING / fine)
    poses = arm.poses(film.angles[np.r_[first, second]], _some(film.opening, first, second))
    where = np.stack([placed(row[owners], points[:, None])[:, 0] for row in poses])
    return MotionCells(np.stack(share), where.astype(np.float32), grid, cell, film.K)


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


def search(
    changes: MotionCells, finer: MotionCells, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """The poses that explain most, one from each of a few sides, the best first.

    Args:
        changes: What changes in the pictures, in coarse cells.
        finer: The same in finer ones.
        seed: Of the variations.

    Returns:
        Poses [k, 4, 4], and how well they fit [k]; k is at most `SIDES`.
    """
    rng = np.random.default_rng(seed)
    middle = _moving_middle(changes)
    poses = _around(changes, middle)
    fits = changes.fits(poses)
    ways = poses[:, :3, 3] - middle
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    chosen: list[int] = []
    for i in np.argsort(-fits):
        if all(ways[j] @ ways[i] < np.cos(APART) for j in chosen):
            chosen.append(int(i))
        if len(chosen) == SIDES:
            break
    rough = [_improved(changes, poses[i], middle, rng) for i in chosen]
    most = max(fit for _, fit in rough)
    best = [
        _improved(finer, pose, middle, rng, FINER) for pose, fit in rough if fit > LIKELY * most
    ]
    best.sort(key=lambda one: -one[1])
    return np.stack([pose for pose, _ in best]), np.array([fit for _, fit in best])


def _improved(
    changes: MotionCells,
    pose: np.ndarray,
    middle: np.ndarray,
    rng: np.random.Generator,
    share: float = 1.0,
) -> tuple[np.ndarray, float]:
    """The best pose near one: draws from a normal distribution that follows the best of them."""
    mean, spread = np.zeros(6), np.diag(np.square(share * np.array(WIDE)))
    best, fit = pose, float(changes.fits(pose[None])[0])
    for _ in range(ROUNDS):
        steps = rng.multivariate_normal(mean, spread, DRAWN)
        poses = _varied(pose, middle, steps)
        fits = changes.fits(poses)
        order = np.argsort(-fits)[:ELITE]
        if fits[order[0]] > fit:
            best, fit = poses[order[0]], float(fits[order[0]])
        mean = steps[order].mean(0)
        spread = np.cov(steps[order].T) * 1.2 + np.diag(np.square(0.01 * share * np.array(WIDE)))
    return best, fit


def _moving_middle(changes: MotionCells) -> np.ndarray:
    """Where the arm moves: the middle of that half of its points that moves most."""
    moves = np.ptp(changes.points, axis=0).sum(-1)
    return changes.points[:, moves > np.median(moves)].reshape(-1, 3).mean(0).astype(float)


def _around(changes: MotionCells, middle: np.ndarray) -> np.ndarray:
    """Poses all around the arm, from which what moves is where something changes.

    An arm that is seen in part moves beside the picture, too: so it is also tried half-way to the
    picture's edge beyond the middle of the changes.
    """
    w, h = changes.grid
    y, x = np.divmod(np.arange(w * h), w)
    weights = changes.share.sum(0) / max(float(changes.share.sum()), 1e-9)
    centre = np.array([(weights * (x + 0.5)).sum(), (weights * (y + 0.5)).sum()])
    half = np.array([w, h]) / 2
    sights = [centre, half, centre + BEYOND * (centre - half)]
    poses = []
    for sight in sights:
        lines = (sight * changes.cell - changes.K[:2, 2]) / np.diag(changes.K)[:2]
        ray = np.array([*lines, 1.0]) / np.linalg.norm([*lines, 1.0])
        ahead = Rotation.align_vectors(ray, [0, 0, 1.0])[0].as_matrix()
        for azimuth in np.linspace(-np.pi, np.pi, AZIMUTHS, endpoint=False):
            for elevation in np.deg2rad(ELEVATIONS):
                flat = np.cos(elevation)
                way = np.array([np.cos(azimuth) * flat, np.sin(azimuth) * flat, np.sin(elevation)])
                for distance in DISTANCES:
                    pose = np.asarray(look_at(middle + distance * way, middle), float)
                    pose[:3, :3] = pose[:3, :3] @ ahead.T
                    poses.append(pose)
    return np.stack(poses)


def _varied(pose: np.ndarray, middle: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """A pose, varied by steps [n, 6]: turned about a point, panned and tilted, or nearer."""
    poses = np.tile(pose, (len(steps), 1, 1))
    about = Rotation.from_rotvec(steps[:, :3]).as_matrix()
    own = Rotation.from_rotvec(np.c_[steps[:, 3:5], np.zeros(len(steps))]).as_matrix()
    out = (pose[:3, 3] - middle) * np.exp(steps[:, 5:])
    poses[:, :3, 3] = middle + (about @ out[..., None])[..., 0]
    poses[:, :3, :3] = about @ pose[:3, :3] @ own
    return poses
