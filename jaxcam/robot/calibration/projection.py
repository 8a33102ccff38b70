"""Points, poses and pixels: projection through K and a lens, and small changes of poses.

Pixels are ours: the centre of the first one is (0.5, 0.5). OpenCV's are half a pixel less.
"""

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from jaxcam.interop.cameras.optics import Optics
from jaxcam.rays.lens import PACKED, normalised, sight_lines

HALF = 0.5
"""What OpenCV's pixels lack of ours."""
BEHIND = 1e5
"""Coordinates in pixels of what a camera cannot see: far from all that it can."""


def pixels_of(points: np.ndarray, optics: Optics) -> np.ndarray:
    """Pixels of points in the camera's axes.

    Args:
        points: Metres [..., 3].
        optics: How the camera sees.

    Returns:
        Float64 [..., 2]; very large where the point is behind the camera. What they are outside the
        field of the lens means nothing.
    """
    ahead = points[..., 2] > 1e-6
    flat = np.where(ahead[..., None], points, [0.0, 0.0, 1.0]).reshape(-1, 1, 3)
    zero, own = np.zeros(3), optics.distortion
    # OpenCV's are some ten times as fast as those of `jaxcam.rays`, which look for the lens's fold.
    if own[PACKED - 1]:
        lines = cv2.fisheye.projectPoints(flat, zero, zero, np.eye(3), own[:4])[0]
    else:
        lines = cv2.projectPoints(flat, zero, zero, np.eye(3), own[: PACKED - 1])[0]
    lines = lines.reshape(*points.shape[:-1], 2)
    pixels = lines @ optics.K[:2, :2].T + optics.K[:2, 2]
    return np.where(ahead[..., None], pixels, BEHIND)


def straightened(pixels: np.ndarray, optics: Optics) -> np.ndarray:
    """Normalised coordinates X/Z, Y/Z of what pixels see: K and the lens undone.

    Args:
        pixels: Float64 [..., 2].
        optics: How the camera sees.

    Returns:
        Float64 [..., 2]; NaN where a pixel has no ray.
    """
    x, y = normalised(optics.K, pixels[..., 0], pixels[..., 1])
    x, y, z = sight_lines(x, y, optics.distortion, "opencv")
    z = np.where(z > 0, z, np.nan)
    return np.stack([x / z, y / z], -1)


def placed(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points [..., 3] of one frame in another, by the first's pose [..., 4, 4] in the other."""
    return (pose[..., None, :3, :3] @ points[..., None])[..., 0] + pose[..., None, :3, 3]


def moved(pose: np.ndarray, change: np.ndarray) -> np.ndarray:
    """A pose after a small motion in its own axes.

    Args:
        pose: Array [4, 4].
        change: Translation (m) and rotation vector (rad), [6].
    """
    result = pose.copy()
    result[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(change[3:]).as_matrix()
    result[:3, 3] = pose[:3, 3] + pose[:3, :3] @ change[:3]
    return result


def change_of(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """The motion that makes one pose [4, 4] of another, as in `moved`: metres and radians, [6]."""
    change = np.linalg.inv(before) @ after
    return np.r_[change[:3, 3], Rotation.from_matrix(change[:3, :3]).as_rotvec()]


def pose_of(rotation: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Poses [..., 4, 4] of rotations [..., 3, 3] and positions [..., 3]."""
    pose = np.zeros((*np.shape(position)[:-1], 4, 4))
    pose[..., :3, :3], pose[..., :3, 3], pose[..., 3, 3] = rotation, position, 1
    return pose


def apart(one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far apart poses are.

    Args:
        one: Array [..., 4, 4].
        other: Array [..., 4, 4].

    Returns:
        Distances of their origins (m) and angles between them (rad), [...].
    """
    cosine = (np.einsum("...ij,...ij->...", one[..., :3, :3], other[..., :3, :3]) - 1) / 2
    distance = np.linalg.norm(one[..., :3, 3] - other[..., :3, 3], axis=-1)
    return distance, np.arccos(np.clip(cosine, -1, 1))


def spread_of(covariance: np.ndarray) -> tuple[float, float]:
    """Standard deviations of a pose: of its position (m, the worst direction) and its rotation.

    Args:
        covariance: Of a change as in `moved`, [6, 6].

    Returns:
        Metres and radians, each of the worst direction.
    """
    parts = covariance[:3, :3], covariance[3:6, 3:6]
    place, turn = (float(np.sqrt(max(np.linalg.eigvalsh(p)[-1], 0))) for p in parts)
    return place, turn
