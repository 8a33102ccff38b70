"""The refinement: the camera's pose, and small faults of the joints, that put contours on edges."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import cv2
import numpy as np

from jaxcam.interrupts import check_stop
from jaxcam.robot.calibration.arm.edges import behind_arm, find_edges
from jaxcam.robot.calibration.arm.film import Film
from jaxcam.robot.calibration.arm.model import ArmModel
from jaxcam.robot.calibration.arm.surface import Contour, Surface, contour, silhouette
from jaxcam.robot.calibration.projection import moved, placed, spread_of

REACHES = (20.0, 14.0, 9.0, 6.0, 4.0, 4.0)
"""Pixels that edges are looked for within, round by round, of a picture 256 high."""
JOINT = np.deg2rad(0.3)
"""Standard deviation of a joint's constant fault before anything was looked (rad)."""
LAG = 0.05
"""Likewise of the time between pictures and states (s)."""
SAMPLES = 0.01
"""Distance (m) between the samples that fill silhouettes."""
CROWD = 8.0
"""Neighbouring points of a contour, and pictures in a row, share their faults: so many count as
one."""
MASK = 120.0
"""Levels of a mask against what is outside it."""
_DELTA = 1e-4


@dataclass(frozen=True)
class Looked:
    """Contour points of all pictures, and how far their edges are off."""

    contours: list[Contour] = field(repr=False)
    rows: np.ndarray = field(repr=False)
    """The picture of each point, [n]."""
    places: np.ndarray = field(repr=False)
    """Where the points are in the camera's axes (m), [n, 3]."""
    offsets: np.ndarray = field(repr=False)
    """Pixels outwards from the contour to the edge, [n]."""
    clear: np.ndarray = field(repr=False)
    """Which points have an edge, bool [n]."""


@dataclass(frozen=True)
class Solution:
    """Where a camera stands, and the faults of joints and clock that come with it."""

    base_from_camera: np.ndarray
    """[4, 4]."""
    joints: np.ndarray
    """What is to be added to the joints' angles (rad), [joints]."""
    lag: float
    """Time (s) by which pictures are later than states."""


@dataclass(frozen=True)
class Prior:
    """What is known of joints and clock before anything was looked."""

    joints: np.ndarray
    """Their faults (rad), [joints]."""
    lag: float = 0.0
    """Of pictures (s)."""
    joint_sigma: float = JOINT
    lag_sigma: float = LAG


class Refiner:
    """Refines poses of one camera.

    Args:
        arm: The robot.
        film: The pictures.
    """

    def __init__(self, arm: ArmModel, film: Film) -> None:
        self.arm, self.film = arm, film
        self.surface = Surface.of(arm.parts)
        points, owners = self.surface.samples(SAMPLES)
        self._samples = [points[owners == number] for number in range(len(arm.parts))]
        self.scale = film.size[1] / 256

    def angles(self, solution: Solution) -> np.ndarray:
        """The joints' angles in each picture, [n, joints]."""
        return self.film.angles + solution.joints + solution.lag * self.film.speeds

    def masks(self, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
        """Silhouettes of all pictures, bool [n, h, w], and the parts' poses [n, parts, 4, 4]."""
        poses = self.arm.poses(self.angles(solution), self.film.opening)
        inverse = np.linalg.inv(solution.base_from_camera)
        K, size = self.film.K, self.film.size
        masks = []
        for row in inverse @ poses:
            there = np.concatenate([
                points @ pose[:3, :3].T + pose[:3, 3]
                for pose, points in zip(row, self._samples, strict=True)
            ])  # fmt: skip
            z = np.where(there[:, 2:] > 0.05, there[:, 2:], np.nan)
            pixels = there[:, :2] / z @ K[:2, :2].T + K[:2, 2]
            masks.append(silhouette(pixels, size, 2 * round(2.5 * self.scale) + 1))
        return np.stack(masks), poses

    def look(self, solution: Solution, reach: float) -> Looked:
        """Contours of a solution, and edges near them."""
        masks, poses = self.masks(solution)
        inverse = np.linalg.inv(solution.base_from_camera)
        width = 2 * int(np.ceil(reach)) + 1
        covered = np.stack([
            cv2.dilate(m.astype(np.uint8), np.ones((width, width), np.uint8)) > 0 for m in masks
        ])  # fmt: skip
        contours, rows, places, offsets, clear = [], [], [], [], []
        for episode in self.film.by_episode():
            check_stop()
            differences = self._differences(episode, covered[episode])
            for i, difference in zip(episode, differences, strict=True):
                outline = contour(
                    self.surface, inverse @ poses[i], self.film.K, masks[i], spacing=3 * self.scale
                )
                edges = find_edges(difference, outline.pixels, outline.normals, reach)
                contours.append(outline)
                rows.append(np.full(len(outline.pixels), i))
                owners = inverse @ poses[i][outline.owners]
                places.append(placed(owners, outline.points[:, None])[:, 0])
                offsets.append(edges.offsets)
                clear.append(edges.clear)
        return Looked(contours, *map(np.concatenate, (rows, places, offsets, clear)))

    def _differences(self, episode: np.ndarray, covered: np.ndarray) -> Iterator[np.ndarray]:
        """Pictures of one episode less their background, or masks of another tool."""
        if self.film.masks is not None:
            for mask in self.film.masks[episode]:
                yield np.repeat(MASK * mask[..., None].astype(np.float32), 3, 2)
            return
        pictures = self.film.rgb[episode]
        behind = behind_arm(pictures, covered)
        for picture in pictures:
            yield picture.astype(np.float32) - behind

    def slopes(self, solution: Solution, looked: Looked) -> np.ndarray:
        """By how much contour points move along their normals, [n, 6 + joints + 1].

        Of small motions of the camera as in `moved`, of the joints, and of the lag.
        """
        angles, opening = self.angles(solution), self.film.opening
        poses = self.arm.poses(angles, opening)
        turned = [
            (self.arm.poses(angles + _DELTA * step, opening) - poses) / _DELTA
            for step in np.eye(self.arm.joints)
        ]
        inverse, K = np.linalg.inv(solution.base_from_camera), self.film.K
        parts = [np.zeros((0, 6 + self.arm.joints + 1))]  # all, where the arm is in no picture
        at = np.cumsum([0, *(len(c.pixels) for c in looked.contours)])
        for number, outline in enumerate(looked.contours):
            if not len(outline.pixels):
                continue
            i = looked.rows[at[number]]
            there = looked.places[at[number] : at[number + 1]]
            x, y, z = there.T
            flat = np.zeros((len(x), 2, 3))
            flat[:, 0, 0], flat[:, 0, 2] = 1 / z, -x / z**2
            flat[:, 1, 1], flat[:, 1, 2] = 1 / z, -y / z**2
            along = np.einsum("ni,ij,njk->nk", outline.normals, K[:2, :2], flat)
            joints = np.stack([
                placed_direction(inverse, d[i][outline.owners], outline.points) for d in turned
            ], -1)  # fmt: skip
            joints = np.einsum("nk,nkj->nj", along, joints)
            lag = joints @ self.film.speeds[i]
            # A camera that moves by d, and turns by w, sees points at -d - w x p.
            parts.append(np.concatenate([-along, np.cross(along, there), joints, lag[:, None]], 1))
        return np.concatenate(parts)

    def refine(
        self,
        solution: Solution,
        reaches: tuple[float, ...] = REACHES,
        prior: Prior | None = None,
    ) -> "Refined":
        """Refines a solution, round by round, looking for edges ever nearer.

        Args:
            solution: Where it begins.
            reaches: Pixels within which edges are looked for, of a picture 256 high.
            prior: What is known of joints and clock; that they are about right when None.
        """
        prior = prior or Prior(np.zeros(self.arm.joints))
        refined = None
        for reach in reaches:
            looked = self.look(solution, reach * self.scale)
            slopes = self.slopes(solution, looked)
            refined = solve_pose(solution, slopes, looked, reach * self.scale / 4, prior)
            solution = refined.solution
        assert refined is not None
        return refined

    def equations(self, solution: Solution, reach: float) -> "Equations":
        """What pictures ask for near a solution, weighted as these pictures alone would be.

        Args:
            solution: Near which is looked.
            reach: Pixels within which edges are looked for, of a picture 256 high.
        """
        looked = self.look(solution, reach * self.scale)
        J, held = self.slopes(solution, looked), _held(Prior(solution.joints), self.arm.joints)
        return _robust(J, looked, reach * self.scale / 4, held, 0 * held)[2]


def placed_direction(inverse: np.ndarray, slopes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """What points of links [n, 3] move by before the camera, by their poses' slopes [n, 4, 4]."""
    there = (slopes[:, :3, :3] @ points[..., None])[..., 0] + slopes[:, :3, 3]
    return there @ inverse[:3, :3].T


@dataclass(frozen=True)
class Refined:
    """A solution, how sure it is, and how well it explains the edges."""

    solution: Solution
    covariance: np.ndarray = field(repr=False)
    """Of small motions of the camera as in `moved`, [6, 6]."""
    looked: Looked = field(repr=False)
    """The contours of the round before, and their edges."""
    left: np.ndarray = field(repr=False)
    """What the solution leaves of the offsets (pixels), [n]."""
    weights: np.ndarray = field(repr=False)
    """Of the points, from 0 to 1, [n]."""
    lag_sigma: float
    """Standard deviation of the lag (s)."""

    @property
    def spread(self) -> tuple[float, float]:
        """Standard deviations of the camera's place (m) and rotation (rad)."""
        return spread_of(self.covariance)

    @property
    def typical(self) -> float:
        """What edges are off, in the median (pixels)."""
        clear = self.looked.clear
        return float(np.median(abs(self.left[clear]))) if clear.any() else np.inf

    def support(self, near: float) -> float:
        """Share of all contour points with an edge within so many pixels."""
        if not len(self.left):
            return 0.0
        return float((self.looked.clear & (abs(self.left) < near)).mean())


@dataclass(frozen=True)
class Equations:
    """What pictures ask for: motions x of camera, joints and clock, in `normal @ x = pull`."""

    normal: np.ndarray = field(repr=False)
    """[6 + joints + 1] squared."""
    pull: np.ndarray = field(repr=False)
    """[6 + joints + 1]."""
    variance: float
    """Of an offset (pixels squared); neighbours count as one."""


def _held(prior: Prior, joints: int) -> np.ndarray:
    """One over the variances that were known beforehand, [6 + joints + 1]."""
    sigmas = np.r_[np.full(joints, prior.joint_sigma), prior.lag_sigma]
    return np.r_[np.full(6, 1e-6), 1 / sigmas**2]


def _robust(
    J: np.ndarray, looked: Looked, sure: float, held: np.ndarray, back: np.ndarray
) -> tuple[np.ndarray, np.ndarray, Equations]:
    """The solution, the points' weights, and the equations that they lead to."""
    x, equations = np.zeros(J.shape[1]), None
    weights = looked.clear.astype(float)
    for _ in range(8):
        left = looked.offsets - J @ x
        spread = 1.48 * np.median(abs(left[looked.clear])) if looked.clear.any() else 1.0
        soft = max(min(2 * spread, sure), 0.5)
        weights = looked.clear / (1 + (left / soft) ** 2)
        variance = max(spread, 0.2) ** 2 * CROWD
        weighted = (J * weights[:, None]).T / variance
        equations = Equations(weighted @ J, weighted @ looked.offsets, variance)
        x = np.linalg.solve(equations.normal + np.diag(held), equations.pull - back)
    assert equations is not None
    return x, weights, equations


def solve_pose(
    solution: Solution, J: np.ndarray, looked: Looked, sure: float, prior: Prior
) -> Refined:
    """Moves a solution so that contours lie on edges, by robust least squares.

    Pictures are the witnesses of its covariance: points of one picture may share their error. What
    joints and clock may be off by beforehand is in it.

    Args:
        solution: Where it begins.
        J: Slopes of the points, see `Refiner.slopes`.
        looked: The edges.
        sure: Pixels from which on an edge counts less (Cauchy).
        prior: What is known of joints and clock.
    """
    held = _held(prior, len(solution.joints))
    now = np.r_[np.zeros(6), solution.joints - prior.joints, solution.lag - prior.lag]
    x, weights, equations = _robust(J, looked, sure, held, held * now)
    variance = equations.variance
    normal = equations.normal + np.diag(held)
    left = looked.offsets - J @ x
    pulls = J * (weights * np.where(looked.clear, left, 0))[:, None] / variance
    pictures = np.zeros((int(looked.rows.max(initial=0)) + 1, len(x)))
    np.add.at(pictures, looked.rows, pulls)
    inverse = np.linalg.inv(normal)
    covariance = inverse @ (pictures.T @ pictures + np.diag(held)) @ inverse
    now = Solution(
        moved(solution.base_from_camera, x[:6]), solution.joints + x[6:-1], solution.lag + x[-1]
    )
    return Refined(
        now, covariance[:6, :6], looked, left, weights, float(np.sqrt(covariance[-1, -1]))
    )
