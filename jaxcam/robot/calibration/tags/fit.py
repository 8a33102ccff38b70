"""Where a camera stands, from tags whose places in the robot's base frame are known.

A single square has two poses that look nearly alike (it may lean towards the camera or away from
it), so every start is refined, and a second pose that fits almost as well refuses the result.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from jaxcam.errors import DatasetError
from jaxcam.interop.cameras.optics import Optics
from jaxcam.rays import invert
from jaxcam.robot.calibration.fitting import Fitted, fit_pixels
from jaxcam.robot.calibration.projection import (
    apart,
    moved,
    pixels_of,
    placed,
    pose_of,
    spread_of,
    straightened,
)
from jaxcam.robot.calibration.tags.places import Tags, square

SURE = 12.0
"""By how much the squared residuals of a second pose must be larger, in variances."""
ELSEWHERE = np.deg2rad(4)
"""Poses that differ by less are one."""
SCALE = 0.03
"""Share by which tags may look larger or smaller than their places allow."""

WRONG = 1.0
"""Residuals (pixels, of a picture 640 wide) from when on a tag may lie elsewhere."""

TagCorners = Mapping[int, np.ndarray]
"""Corners [4, 2] (pixels, ours) of tags in a picture, by their numbers."""


@dataclass(frozen=True)
class PoseFit:
    """Where a camera stands."""

    base_from_camera: np.ndarray
    """[4, 4], OpenCV axes."""
    covariance: np.ndarray = field(repr=False)
    """Of a small motion in the camera's axes: metres, then radians, [6, 6]."""
    numbers: tuple[int, ...]
    """Tags that were seen."""
    dropped: tuple[int, ...]
    """Tags that lie elsewhere than it is said of them; they did not count."""
    pixels: np.ndarray = field(repr=False)
    """Their corners, four each, [n, 2]."""
    residuals: np.ndarray = field(repr=False)
    """The fit less what was seen, [n, 2]."""
    used: np.ndarray = field(repr=False)
    """Which count, bool [n]."""
    rms: float
    """Root mean square of the distances of those that count (pixels)."""

    @property
    def spread(self) -> tuple[float, float]:
        """Standard deviations of its place (m) and its rotation (rad), the worst directions."""
        return spread_of(self.covariance)


def middle_corners(pictures: Sequence[TagCorners]) -> dict[int, np.ndarray]:
    """Corners of several pictures of a camera that stands still: medians, by the tag's number."""
    numbers = sorted({number for picture in pictures for number in picture})
    return {n: np.median([p[n] for p in pictures if n in p], 0) for n in numbers}


def shifts(pictures: Sequence[TagCorners], middle: TagCorners) -> np.ndarray:
    """How far tags are from their middle places in each picture (pixels), [pictures].

    Args:
        pictures: The corners in each.
        middle: Those that they are compared with.

    Returns:
        Medians over the corners; NaN where a picture shows no tag.
    """
    result = np.full(len(pictures), np.nan)
    for i, picture in enumerate(pictures):
        off = [np.linalg.norm(picture[n] - middle[n], axis=-1) for n in picture if n in middle]
        if off:
            result[i] = np.median(np.concatenate(off))
    return result


def locate(sight: TagCorners, tags: Tags, optics: Optics) -> PoseFit:
    """Finds where a camera stands.

    Args:
        sight: Corners of tags in its picture; tags whose place nobody says do not count.
        tags: Their places.
        optics: How the camera sees.

    Raises:
        DatasetError: No known tag is there, two poses explain what was seen, or the tags have
            another size or other places.
    """
    numbers = tuple(n for n in sorted(sight) if n in tags.corners)
    if not numbers:
        raise DatasetError(
            f"no tag whose place is known: seen {sorted(sight) or 'none'}, known "
            f"{sorted(tags.corners)}."
        )
    best, dropped = _best(numbers, sight, tags, optics), ()
    limit = WRONG * max(optics.width / 640, 0.5)
    if best.fitted.rms > limit and len(numbers) > 2:
        fewer = [
            (n, _best(tuple(m for m in numbers if m != n), sight, tags, optics)) for n in numbers
        ]
        number, other = min(fewer, key=lambda one: one[1].fitted.rms)
        if other.fitted.rms < limit:
            best, dropped = other, (number,)
    if len(best.numbers) > 1:
        _check_size(best, tags, optics)
    if best.fitted.rms < limit:
        _check_only(best)
    covariance = best.fitted.covariance + _of_places(best, tags, optics)
    return PoseFit(
        best.pose, covariance, best.numbers, dropped, best.pixels, best.fitted.residuals,
        best.fitted.used, best.fitted.rms,
    )  # fmt: skip


@dataclass(frozen=True)
class _Best:
    """The pose that explains some tags best, and the others that were tried."""

    numbers: tuple[int, ...]
    points: np.ndarray
    pixels: np.ndarray
    pose: np.ndarray
    fitted: Fitted
    others: tuple[tuple[np.ndarray, float], ...]
    """Poses, and by how much their squared residuals are larger."""


def _best(numbers: tuple[int, ...], sight: TagCorners, tags: Tags, optics: Optics) -> _Best:
    points = np.concatenate([tags.corners[n] for n in numbers])
    pixels = np.concatenate([sight[n] for n in numbers])
    fits = [
        (start, _refined(start, points, pixels, optics))
        for start in _starts(numbers, sight, points, pixels, tags, optics)
    ]
    if not fits:
        raise DatasetError(f"no pose explains tags {list(numbers)}.")
    costs = [_cost(fitted) for _, fitted in fits]
    first = int(np.argmin(costs))
    poses = [moved(start, fitted.values) for start, fitted in fits]
    others = tuple((pose, cost - costs[first]) for pose, cost in zip(poses, costs, strict=True))
    return _Best(numbers, points, pixels, poses[first], fits[first][1], others)


def flat_poses(points: np.ndarray, pixels: np.ndarray, optics: Optics) -> list[np.ndarray]:
    """The two poses of something flat that explain its picture, the better one first.

    Args:
        points: In its own axes, [m, 3], all z zero; of a tag, the corners of `square`.
        pixels: Where they are, [m, 2].
        optics: How the camera sees.

    Returns:
        Camera from it, [4, 4] each.
    """
    rays = straightened(pixels, optics)
    if not np.isfinite(rays).all():
        return []
    is_tag = len(points) == 4
    middle = points.mean(0)
    try:
        _, turns, places, _ = cv2.solvePnPGeneric(
            points - middle, rays, np.eye(3), None,
            flags=cv2.SOLVEPNP_IPPE_SQUARE if is_tag else cv2.SOLVEPNP_IPPE,
        )  # fmt: skip
    except cv2.error:
        return []
    rotations = [cv2.Rodrigues(turn)[0] for turn in turns]
    poses = [
        pose_of(rotation, place[:, 0] - rotation @ middle)
        for rotation, place in zip(rotations, places, strict=True)
    ]
    return [pose for pose in poses if np.isfinite(pose).all()]


def _starts(
    numbers: Sequence[int],
    sight: TagCorners,
    points: np.ndarray,
    pixels: np.ndarray,
    tags: Tags,
    optics: Optics,
) -> list[np.ndarray]:
    """Base from camera, roughly: of each tag alone, in both its poses, and of all together."""
    starts = []
    for number in numbers:
        base_from_tag = frame_of(tags.corners[number])
        poses = flat_poses(square(tags.sizes[number]), sight[number], optics)
        starts += [base_from_tag @ np.linalg.inv(camera_from_tag) for camera_from_tag in poses]
    if len(numbers) > 1:
        rays = straightened(pixels, optics)
        done, turn, place = cv2.solvePnP(
            points, rays, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP
        )  # fmt: skip
        if done and np.isfinite([turn, place]).all():
            starts.insert(0, np.linalg.inv(pose_of(cv2.Rodrigues(turn)[0], place[:, 0])))
        off = [_off(start, points, pixels, optics) for start in starts]
        starts = [starts[i] for i in np.argsort(off)[:3]]  # far more would be refined for nothing
    return starts


def frame_of(corners: np.ndarray) -> np.ndarray:
    """Pose of a tag's own axes, [4, 4], from its corners [4, 3]."""
    x = corners[1] + corners[2] - corners[0] - corners[3]
    y = corners[0] + corners[1] - corners[2] - corners[3]
    x = x / np.linalg.norm(x)
    z = np.cross(x, y / np.linalg.norm(y))
    z /= np.linalg.norm(z)
    return pose_of(np.stack([x, np.cross(z, x), z], -1), corners.mean(0))


def _off(pose: np.ndarray, points: np.ndarray, pixels: np.ndarray, optics: Optics) -> float:
    fitted = pixels_of(placed(np.asarray(invert(pose)), points), optics)
    return float(np.median(np.linalg.norm(fitted - pixels, axis=-1)))


def _refined(start: np.ndarray, points: np.ndarray, pixels: np.ndarray, optics: Optics) -> Fitted:
    return fit_pixels(
        lambda x: pixels_of(placed(np.linalg.inv(moved(start, x)), points), optics) - pixels,
        np.zeros(6),
    )


def _cost(fitted: Fitted) -> float:
    """Squared residuals, of which no corner counts for more than a few pixels."""
    return float(np.minimum((fitted.residuals**2).sum(-1), 25.0).sum())


def _check_only(best: _Best) -> None:
    for pose, more in best.others:
        angle = float(apart(best.pose, pose)[1])
        if angle > ELSEWHERE and more < SURE * best.fitted.sigma**2:
            raise DatasetError(
                f"tag {', '.join(map(str, best.numbers))}: two poses explain the picture "
                f"nearly as well ({np.rad2deg(angle):.0f} degrees apart), as of any small square "
                "that faces the camera. Put a second tag somewhere else, not beside it, or come "
                "nearer, or look at it from 30 degrees or more to the side."
            )


def _check_size(best: _Best, tags: Tags, optics: Optics) -> None:
    """Refuses tags that look larger or smaller than their distances from each other allow."""
    numbers, points, pose = best.numbers, best.points, best.pose
    middles = np.repeat([tags.corners[n].mean(0) for n in numbers], 4, 0)

    def residuals(x: np.ndarray) -> np.ndarray:
        scaled = middles + (1 + x[6]) * (points - middles)
        return pixels_of(placed(np.linalg.inv(moved(pose, x[:6])), scaled), optics) - best.pixels

    fitted = fit_pixels(residuals, np.zeros(7))
    scale, deviation = fitted.values[6], float(np.sqrt(fitted.covariance[6, 6]))
    if abs(scale) > max(SCALE, 5 * deviation):
        sizes = sorted({tags.sizes[n] for n in numbers})
        said = ", ".join(f"{1000 * s:.0f}" for s in sizes)
        got = ", ".join(f"{1000 * s * (1 + scale):.0f}" for s in sizes)
        raise DatasetError(
            f"the tags are said to be {said} mm, but look like {got} mm at these places. 'size' is "
            "the side of the black square without the white margin: measure it on the print; or "
            "the tags lie elsewhere than the file says."
        )


def _of_places(best: _Best, tags: Tags, optics: Optics) -> np.ndarray:
    """What not knowing the tags' places exactly adds to the covariance, [6, 6]."""
    if not tags.accuracy:
        return np.zeros((6, 6))
    numbers, points, pose, fitted = best.numbers, best.points, best.pose, best.fitted

    def project(x: np.ndarray, where: np.ndarray) -> np.ndarray:
        return pixels_of(placed(np.linalg.inv(moved(pose, x)), where), optics)[fitted.used]

    h = 1e-6
    slopes = np.stack(
        [(project(h * e, points) - project(-h * e, points)).ravel() / (2 * h) for e in np.eye(6)],
        -1,
    )
    gain = np.linalg.pinv(slopes)
    added = np.zeros((6, 6))
    for i, number in enumerate(numbers):
        frame, own = frame_of(tags.corners[number]), slice(4 * i, 4 * i + 4)
        for k, step in enumerate(np.eye(6)):
            size = h if k < 3 else h / tags.sizes[number]
            ahead = points.copy()
            local = placed(np.asarray(invert(frame)), points[own])
            ahead[own] = placed(moved(frame, size * step), local)
            change = (project(np.zeros(6), ahead) - project(np.zeros(6), points)).ravel() / h
            effect = gain @ change * tags.accuracy
            added += np.outer(effect, effect)
    return added
