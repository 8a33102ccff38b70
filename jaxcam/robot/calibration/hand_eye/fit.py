"""Where a camera is, and a tag or a board, one of which the hand carries.

With M_i the pose, in the frame that the camera is fixed to (its mount), of what the tag is fixed to
(its holder), C_i the tag before the camera, X the camera on its mount and Z the tag on its holder:
M_i Z = X C_i. Of a camera that stands, the mount is the base and the holder the grip; of a camera
on the hand it is the other way round. A linear solution (Shah 2013, by the Kronecker product;
OpenCV 5 has no such solver) of a few pictures at a time begins, since each C_i of a small square
has two candidates; that which explains most pictures is refined on the pixels of all.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from jaxcam.errors import DatasetError
from jaxcam.interop.cameras.optics import Optics
from jaxcam.rays.rotations import nearest_rotation
from jaxcam.robot.calibration.fitting import PIXEL, WEIGHT, Fitted, fit_pixels, numeric_jacobian
from jaxcam.robot.calibration.projection import moved, pixels_of, placed, pose_of, spread_of
from jaxcam.robot.calibration.tags.fit import flat_poses

TRIALS = 80
"""Few pictures that are tried at a time."""
FEW = 4
TURNED = np.deg2rad(8)
"""Spread of the hand's rotations about a second axis that is needed."""
ADVISED = 30
"""What one should turn the hand by (degrees)."""
ENOUGH = 6
"""Pictures that are needed."""


Also = Literal["", "delay", "scale"]
"""One more unknown: by how many steps states are late, or how many times larger the target is."""


@dataclass(frozen=True)
class Seen:
    """A tag or a board in a picture."""

    points: np.ndarray
    """Its corners in its own axes, [m, 3] (m), all z zero."""
    pixels: np.ndarray
    """Where they are, [m, 2], ours."""


@dataclass(frozen=True)
class HandEyeFit:
    """A camera, and a tag or a board: one on the hand, one that stands."""

    mount_from_camera: np.ndarray
    """[4, 4], OpenCV axes; base from camera, or grip from camera."""
    holder_from_target: np.ndarray
    """[4, 4]; a tag's axes: x right, y up, z out; a board's: x right, y down, z into it."""
    covariance: np.ndarray = field(repr=False)
    """Of small motions of both in their own axes, and of the other unknown, [12, 12] or [13, 13]"""
    residuals: tuple[np.ndarray, ...] = field(repr=False)
    """The fit less what was seen, [m, 2] of each picture (pixels)."""
    used: tuple[np.ndarray, ...] = field(repr=False)
    """Which corners count, bool [m] of each picture."""
    rms: float
    """Root mean square of the distances of those that count (pixels)."""
    also: float = 0.0
    """The other unknown; the delay where nothing else is."""

    @property
    def spread(self) -> tuple[float, float]:
        """Standard deviations of the camera's place (m) and rotation (rad)."""
        return spread_of(self.covariance[:6, :6])

    @property
    def target_spread(self) -> tuple[float, float]:
        """Likewise of the tag or the board."""
        return spread_of(self.covariance[6:12, 6:12])

    @property
    def share(self) -> float:
        """How many corners count, of all."""
        return float(np.concatenate(self.used).mean())

    @property
    def median(self) -> float:
        """Half of all corners are farther off (pixels)."""
        return _median(np.concatenate(self.residuals))


def fit_hand_eye(
    mount_from_holder: np.ndarray, sights: Sequence[Seen], optics: Optics, delay: float = 0.0
) -> HandEyeFit:
    """Finds the camera and the tag or board.

    Args:
        mount_from_holder: In each picture, what carries the one in the frame of what carries the
            other, [n, 4, 4]: base from grip if the camera stands, grip from base if it is on the
            hand.
        sights: The tag or board there.
        optics: How the camera sees.
        delay: Steps by which states were taken to be late, for the record.

    Raises:
        DatasetError: There are too few pictures, or the hand does not turn about two axes.
    """
    if len(sights) < ENOUGH:
        raise DatasetError(
            f"{len(sights)} pictures with the target and different poses; at least {ENOUGH} are "
            "needed, 15 are good."
        )
    check_motions(mount_from_holder)
    starts = _starts(mount_from_holder, sights, optics)
    if not starts:
        raise DatasetError("No pose of the camera explains the target in any few pictures.")
    fits = [
        refine(lambda _: mount_from_holder, sights, optics, start, near=delay) for start in starts
    ]
    return min(fits, key=lambda fit: fit.median)


def refine(
    mount_from_holder: Callable[[float], np.ndarray],
    sights: Sequence[Seen],
    optics: Optics,
    start: tuple[np.ndarray, np.ndarray],
    also: Also = "",
    near: float = 0.0,
) -> HandEyeFit:
    """Fits both poses, and perhaps one more unknown, to the pixels of all pictures.

    Args:
        mount_from_holder: By how many steps states are late, see `fit_hand_eye`, [n, 4, 4].
        sights: The tag or board.
        optics: How the camera sees.
        start: The camera and the target, roughly.
        also: The other unknown.
        near: Where the delay is, roughly; the value that it has if it is not unknown.
    """
    points = np.concatenate([s.points for s in sights])
    pixels = np.concatenate([s.pixels for s in sights])
    counts = [len(s.pixels) for s in sights]
    picture = np.repeat(np.arange(len(sights)), counts)

    def residuals(x: np.ndarray) -> np.ndarray:
        camera, target = moved(start[0], x[:6]), moved(start[1], x[6:12])
        poses = mount_from_holder(near + (x[12] if also == "delay" else 0.0))
        poses = np.linalg.inv(camera) @ poses @ target
        places = points * (1 + x[12]) if also == "scale" else points
        return pixels_of(placed(poses[picture], places[:, None])[:, 0], optics) - pixels

    fitted = fit_pixels(residuals, np.zeros(13 if also else 12))
    ends = np.cumsum(counts)[:-1]
    slopes = numeric_jacobian(residuals, fitted.values)
    return HandEyeFit(
        moved(start[0], fitted.values[:6]),
        moved(start[1], fitted.values[6:12]),
        _covariance(slopes, fitted, picture),
        tuple(np.split(fitted.residuals, ends)),
        tuple(np.split(fitted.used, ends)),
        fitted.rms,
        float(fitted.values[12]) + (near if also == "delay" else 1.0) if also else near,
    )


def _covariance(slopes: np.ndarray, fitted: Fitted, picture: np.ndarray) -> np.ndarray:
    """Of all unknowns, where what a picture's corners have in common is one error.

    A grip's pose that is half a millimetre off moves all corners: they are not so many witnesses.
    """
    count, unknowns = int(picture.max()) + 1, slopes.shape[-1]
    used = fitted.used[:, None]
    residuals, J = np.where(used, fitted.residuals, 0), np.where(used[..., None], slopes, 0)
    each, common, J_sum = np.zeros((count, 1)), np.zeros((count, 2)), np.zeros((count, 2, unknowns))
    np.add.at(each, picture, used.astype(float))
    np.add.at(common, picture, residuals)
    np.add.at(J_sum, picture, J)
    common /= np.maximum(each, 1)
    pictures = int((each > 0).sum())
    own = float((np.where(used, residuals - common[picture], 0) ** 2).sum())
    own /= max(2 * (float(each.sum()) - pictures), 1)
    own = max(own, PIXEL**2 / WEIGHT)
    shared = float((common**2).sum()) / max(2 * pictures - unknowns, 2)
    shared = max(shared - own / max(float(np.median(each[each > 0])), 1), 0.0)
    normal = np.einsum("nip,niq->pq", J, J)
    scale = 1 / np.sqrt(np.maximum(np.diag(normal), 1e-12))
    inverse = np.linalg.pinv(normal * np.outer(scale, scale), rcond=1e-14, hermitian=True)
    inverse = inverse * np.outer(scale, scale)
    middle = own * normal + shared * np.einsum("nip,niq->pq", J_sum, J_sum)
    return inverse @ middle @ inverse


def turns_of(base_from_grip: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How much the hand turns, and about which of its axes.

    Args:
        base_from_grip: Poses [n, 4, 4].

    Returns:
        Spreads (rad) about three axes, the largest first, [3], and these axes in the grip's own
        frame, in rows, [3, 3].
    """
    rotations = Rotation.from_matrix(base_from_grip[:, :3, :3])
    turns = (rotations.mean().inv() * rotations).as_rotvec()
    values, axes = np.linalg.eigh(turns.T @ turns / len(turns))
    return np.sqrt(np.maximum(values[::-1], 0)), axes.T[::-1]


def check_motions(base_from_grip: np.ndarray) -> None:
    """Refuses motions that leave the camera's pose undetermined, and says which are lacking.

    Args:
        base_from_grip: Poses of the grip, [n, 4, 4].

    Raises:
        DatasetError: The hand turns about one axis only, or not at all.
    """
    spreads, axes = turns_of(base_from_grip)
    if spreads[1] >= TURNED:
        return
    degrees = np.rad2deg(spreads)
    names = " or ".join(_axis(axis) for axis in axes[1:])
    if spreads[0] < TURNED:
        raise DatasetError(
            f"The hand hardly turns: its rotations spread by {degrees[0]:.1f} degrees, and "
            f"{degrees[1]:.1f} about a second axis. The camera's pose is not determined. Turn the "
            f"hand by {ADVISED} degrees and more, about two of its axes, as long as the tag can be "
            "seen."
        )
    raise DatasetError(
        f"The hand turns about one axis only: {_axis(axes[0])} by {degrees[0]:.1f} degrees, others "
        f"by {degrees[1]:.1f}; the camera's place along that axis is not determined. Lacking: "
        f"turns about {names} of the grip, by {ADVISED} degrees and more (tilt the hand, too)."
    )


def _axis(axis: np.ndarray) -> str:
    largest = int(np.argmax(np.abs(axis)))
    if abs(axis[largest]) > 0.85:
        return f"its {'xyz'[largest]} axis"
    return f"the axis ({', '.join(f'{x:.1f}' for x in axis)})"


def _median(residuals: np.ndarray) -> float:
    return float(np.median(np.linalg.norm(residuals, axis=-1)))


def _starts(
    poses: np.ndarray, sights: Sequence[Seen], optics: Optics
) -> list[tuple[np.ndarray, np.ndarray]]:
    """The camera and the target, roughly: the best three of those that few pictures give."""
    candidates = [flat_poses(s.points, s.pixels, optics) for s in sights]
    usable = np.array([i for i, some in enumerate(candidates) if some])
    if len(usable) < FEW:
        return []
    rng, ranked = np.random.default_rng(0), []
    for trial in range(TRIALS):
        few = rng.choice(usable, FEW if trial else min(len(usable), 12), replace=False)
        targets = np.stack([
            candidates[i][int(rng.random() < 0.3) if trial and len(candidates[i]) > 1 else 0]
            for i in few
        ])  # fmt: skip
        camera, target = solve_linear(poses[few], targets)
        if not np.isfinite([camera, target]).all():
            continue
        ranked.append((off_by(poses, sights, optics, (camera, target)), trial, (camera, target)))
    return [both for _, _, both in sorted(ranked, key=lambda one: one[:2])[:3]]


def off_by(
    mount_from_holder: np.ndarray,
    sights: Sequence[Seen],
    optics: Optics,
    both: tuple[np.ndarray, np.ndarray],
) -> float:
    """By how much (pixels) half of all corners are off at least, for a camera and a target."""
    there = np.linalg.inv(both[0]) @ mount_from_holder @ both[1]
    picture = np.repeat(np.arange(len(sights)), [len(s.points) for s in sights])
    points = np.concatenate([s.points for s in sights])
    pixels = pixels_of(placed(there[picture], points[:, None])[:, 0], optics)
    return _median(pixels - np.concatenate([s.pixels for s in sights]))


def solve_linear(
    mount_from_holder: np.ndarray, camera_from_target: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The camera X and the target Z with M_i Z = X C_i, as far as there are such: least squares.

    Shah, "Solving the robot-world/hand-eye calibration problem using the Kronecker product",
    Journal of Mechanisms and Robotics 5(3), 2013.

    Args:
        mount_from_holder: M_i, [n, 4, 4], n at least 3.
        camera_from_target: C_i, [n, 4, 4].

    Returns:
        Mount from camera and holder from target, [4, 4] each.
    """
    M, C = mount_from_holder[:, :3, :3], camera_from_target[:, :3, :3]
    # Row by row, vec(M Z) = (M ⊗ 1) vec(Z) and vec(X C) = (1 ⊗ Cᵀ) vec(X).
    one = np.eye(3)
    rows = [
        np.concatenate([np.kron(m, one), -np.kron(one, c.T)], 1) for m, c in zip(M, C, strict=True)
    ]
    both = np.linalg.svd(np.concatenate(rows))[2][-1]
    Z, X = both[:9].reshape(3, 3), both[9:].reshape(3, 3)
    sign = np.sign(np.linalg.det(X)) or 1.0
    Z, X = np.asarray(nearest_rotation(sign * Z)), np.asarray(nearest_rotation(sign * X))
    n = len(M)
    left = np.concatenate([M, -np.tile(one, (n, 1, 1))], -1).reshape(-1, 6)
    right = camera_from_target[:, :3, 3] @ X.T - mount_from_holder[:, :3, 3]
    places = np.linalg.lstsq(left, right.ravel(), rcond=None)[0]
    return pose_of(X, places[3:]), pose_of(Z, places[:3])


def most_different_poses(poses: np.ndarray, allowed: np.ndarray, most: int) -> list[int]:
    """Numbers of the poses that differ most, in order.

    Args:
        poses: Array [n, 4, 4].
        allowed: Which may be taken, bool [n].
        most: How many at most.
    """
    candidates = np.flatnonzero(allowed)
    if not len(candidates):
        return []
    rotations = poses[candidates, :3, :3].reshape(-1, 9) / 0.6
    features = np.concatenate([poses[candidates, :3, 3] / 0.15, rotations], -1)
    chosen = [0]
    far = np.linalg.norm(features - features[0], axis=-1)
    while len(chosen) < min(most, len(candidates)) and far.max() > 1e-3:
        chosen.append(int(np.argmax(far)))
        far = np.minimum(far, np.linalg.norm(features - features[chosen[-1]], axis=-1))
    return sorted(int(candidates[i]) for i in chosen)


def slow_steps(poses: Sequence[np.ndarray]) -> np.ndarray:
    """Which steps are slow, of all episodes one after the other, bool [n].

    Pictures of a fast hand are blurred, and its state is of another moment than the picture.

    Args:
        poses: Of the grip in each episode, [T, 4, 4].
    """
    speeds = []
    for episode in poses:
        step = np.zeros(len(episode))
        if len(episode) > 1:
            place = np.linalg.norm(np.diff(episode[:, :3, 3], axis=0), axis=-1)
            turn = np.linalg.norm(np.diff(episode[:, :3, :3], axis=0), axis=(1, 2))
            moved_by = place + 0.1 * turn
            step = np.maximum(np.r_[moved_by, moved_by[-1]], np.r_[moved_by[0], moved_by])
        speeds.append(step)
    speed = np.concatenate(speeds)
    return speed <= np.median(speed)
