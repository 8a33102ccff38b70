"""Where a camera stands that sees a tag on the hand, and where the tag sits there.

With B_i the grip in the base frame, C_i the tag before the camera, X the camera in the base frame
and Z the tag on the grip: B_i Z = X C_i. A linear solution (Shah 2013, by the Kronecker product;
OpenCV 5 has no such solver) of a few pictures at a time begins, since each C_i of a square has two
candidates; that which explains most pictures is refined on the pixels of all.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from jaxcam.errors import DatasetError
from jaxcam.interop.cameras.optics import Optics
from jaxcam.rays.rotations import nearest_rotation
from jaxcam.robot.calibration.fitting import PIXEL, WEIGHT, Fitted, fit_pixels, numeric_jacobian
from jaxcam.robot.calibration.projection import moved, pixels_of, placed, pose_of, spread_of
from jaxcam.robot.calibration.tags.fit import tag_poses
from jaxcam.robot.calibration.tags.places import square

TRIALS = 80
"""Few pictures that are tried at a time."""
FEW = 4
TURNED = np.deg2rad(8)
"""Spread of the hand's rotations about a second axis that is needed."""
ADVISED = 30
"""What one should turn the hand by (degrees)."""
ENOUGH = 6
"""Pictures that are needed."""


@dataclass(frozen=True)
class HandEyeFit:
    """A camera, and a tag on the hand."""

    base_from_camera: np.ndarray
    """[4, 4], OpenCV axes."""
    grip_from_tag: np.ndarray
    """[4, 4]; the tag's axes: x right, y up, z out."""
    covariance: np.ndarray = field(repr=False)
    """Of small motions of both in their own axes, [12, 12]."""
    residuals: np.ndarray = field(repr=False)
    """The fit less what was seen, [pictures, 4, 2] (pixels)."""
    used: np.ndarray = field(repr=False)
    """Which corners count, bool [pictures, 4]."""
    rms: float
    """Root mean square of the distances of those that count (pixels)."""

    @property
    def spread(self) -> tuple[float, float]:
        """Standard deviations of the camera's place (m) and rotation (rad)."""
        return spread_of(self.covariance[:6, :6])

    @property
    def tag_spread(self) -> tuple[float, float]:
        """Likewise of the tag on the hand."""
        return spread_of(self.covariance[6:, 6:])


def fit_hand_eye(
    base_from_grip: np.ndarray, corners: np.ndarray, size: float, optics: Optics
) -> HandEyeFit:
    """Finds the camera and the tag.

    Args:
        base_from_grip: Poses of the grip in each picture, [n, 4, 4].
        corners: Of the tag there, [n, 4, 2] (pixels, ours), from the upper left one clockwise.
        size: Side of the tag (m).
        optics: How the camera sees.

    Raises:
        DatasetError: There are too few pictures, or the hand does not turn about two axes.
    """
    if len(corners) < ENOUGH:
        raise DatasetError(
            f"{len(corners)} pictures with the tag and different poses; at least {ENOUGH} are "
            "needed, 15 are good."
        )
    check_motions(base_from_grip)
    points = square(size)
    starts = _starts(base_from_grip, corners, size, optics)
    if not starts:
        raise DatasetError("No pose of the camera explains the tag in any few pictures.")

    def residuals(start: tuple[np.ndarray, np.ndarray], x: np.ndarray) -> np.ndarray:
        camera, tag = moved(start[0], x[:6]), moved(start[1], x[6:])
        return (_pixels(camera, tag, base_from_grip, points, optics) - corners).reshape(-1, 2)

    best: tuple[tuple[np.ndarray, np.ndarray], Fitted] | None = None
    for start in starts:
        fitted = fit_pixels(lambda x, start=start: residuals(start, x), np.zeros(12))
        if best is None or _median(fitted.residuals) < _median(best[1].residuals):
            best = start, fitted
    assert best is not None
    start, fitted = best
    shape = corners.shape[:2]
    return HandEyeFit(
        moved(start[0], fitted.values[:6]),
        moved(start[1], fitted.values[6:]),
        _covariance(
            numeric_jacobian(lambda x: residuals(start, x), fitted.values), fitted, len(corners)
        ),
        fitted.residuals.reshape(*shape, 2),
        fitted.used.reshape(shape),
        fitted.rms,
    )


def _covariance(slopes: np.ndarray, fitted: Fitted, count: int) -> np.ndarray:
    """Of both poses, [12, 12], where what a picture's corners have in common is one error.

    A grip's pose that is half a millimetre off moves all four corners: they are not four witnesses.
    """
    used = fitted.used.reshape(count, 4, 1)
    residuals = np.where(used, fitted.residuals.reshape(count, 4, 2), 0)
    J = np.where(used[..., None], slopes.reshape(count, 4, 2, 12), 0)
    each = np.maximum(used.sum(1), 1)
    common = residuals.sum(1) / each
    pictures = int(used.any((1, 2)).sum())
    own = float(((residuals - np.where(used, common[:, None], 0)) ** 2).sum())
    own = max(own / max(6 * pictures, 1), PIXEL**2 / WEIGHT)
    shared = float((common**2).sum()) / max(2 * pictures - 12, 2)
    shared = max(shared - own / 4, 0.0)
    inverse = np.linalg.pinv(np.einsum("nkip,nkiq->pq", J, J), rcond=1e-14, hermitian=True)
    middle = own * np.einsum("nkip,nkiq->pq", J, J)
    middle = middle + shared * np.einsum("nip,niq->pq", J.sum(1), J.sum(1))
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


def _pixels(
    camera: np.ndarray, tag: np.ndarray, grips: np.ndarray, points: np.ndarray, optics: Optics
) -> np.ndarray:
    """Pixels of the tag's corners in each picture, [n, 4, 2]."""
    return pixels_of(placed(np.linalg.inv(camera) @ grips @ tag, points), optics)


def _starts(
    grips: np.ndarray, corners: np.ndarray, size: float, optics: Optics
) -> list[tuple[np.ndarray, np.ndarray]]:
    """The camera and the tag, roughly: the best three of those that few pictures give."""
    candidates = [tag_poses(some, size, optics) for some in corners]
    usable = np.array([i for i, some in enumerate(candidates) if some])
    if len(usable) < FEW:
        return []
    rng, ranked, points = np.random.default_rng(0), [], square(size)
    for trial in range(TRIALS):
        few = rng.choice(usable, FEW if trial else min(len(usable), 12), replace=False)
        tags = np.stack([
            candidates[i][int(rng.random() < 0.3) if trial and len(candidates[i]) > 1 else 0]
            for i in few
        ])  # fmt: skip
        camera, tag = solve_linear(grips[few], tags)
        if not np.isfinite([camera, tag]).all():
            continue
        off = np.linalg.norm(_pixels(camera, tag, grips, points, optics) - corners, axis=-1)
        ranked.append((float(np.median(off)), trial, (camera, tag)))
    return [both for _, _, both in sorted(ranked, key=lambda one: one[:2])[:3]]


def solve_linear(
    base_from_grip: np.ndarray, camera_from_tag: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The camera X and the tag Z with B_i Z = X C_i, as far as there are such: least squares.

    Shah, "Solving the robot-world/hand-eye calibration problem using the Kronecker product",
    Journal of Mechanisms and Robotics 5(3), 2013.

    Args:
        base_from_grip: B_i, [n, 4, 4], n at least 3.
        camera_from_tag: C_i, [n, 4, 4].

    Returns:
        Base from camera and grip from tag, [4, 4] each.
    """
    B, C = base_from_grip[:, :3, :3], camera_from_tag[:, :3, :3]
    # Row by row, vec(B Z) = (B ⊗ 1) vec(Z) and vec(X C) = (1 ⊗ Cᵀ) vec(X).
    one = np.eye(3)
    rows = [
        np.concatenate([np.kron(b, one), -np.kron(one, c.T)], 1) for b, c in zip(B, C, strict=True)
    ]
    both = np.linalg.svd(np.concatenate(rows))[2][-1]
    Z, X = both[:9].reshape(3, 3), both[9:].reshape(3, 3)
    sign = np.sign(np.linalg.det(X)) or 1.0
    Z, X = np.asarray(nearest_rotation(sign * Z)), np.asarray(nearest_rotation(sign * X))
    n = len(B)
    left = np.concatenate([B, -np.tile(one, (n, 1, 1))], -1).reshape(-1, 6)
    right = camera_from_tag[:, :3, 3] @ X.T - base_from_grip[:, :3, 3]
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
