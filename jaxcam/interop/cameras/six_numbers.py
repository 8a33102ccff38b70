"""Poses of DROID's data: six numbers, a translation in metres and Euler angles about x, y and z.

They are of the camera in the robot's base frame, OpenCV axes, and of its grip likewise. The angles
are SciPy's "xyz", about the base's fixed axes: R = Rz(c) Ry(b) Rx(a), as DROID's own
`droid/misc/transformations.py` has it.
In LeRobot's form of DROID they are columns, `camera_extrinsics.<view>`.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from jaxcam.data.recorded.recording import Placement
from jaxcam.errors import CameraError
from jaxcam.rays import check_pose

COLUMN = "camera_extrinsics.{view}"
"""The column of a view's six numbers in LeRobot's form of DROID."""
STILL = 1e-6
"""Numbers of a camera that stands still differ by less, in float32."""


def poses_of(numbers: np.ndarray, where: str) -> np.ndarray:
    """Poses of DROID's numbers.

    Args:
        numbers: Of the poses, [..., 6], metres and radians.
        where: Whose they are, for messages.

    Returns:
        Float64 [..., 4, 4].

    Raises:
        CameraError: They are no poses, or their angles are in degrees.
    """
    numbers = np.asarray(numbers, np.float64)
    if numbers.shape[-1:] != (6,):
        raise CameraError(
            f"{where}: shape {list(numbers.shape)}; expected six numbers, a translation (m) and "
            "XYZ Euler angles (rad)."
        )
    if (np.abs(numbers[..., 3:]) > 2 * np.pi).any():
        largest = np.abs(numbers[..., 3:]).max()
        raise CameraError(
            f"{where}: an angle of {largest:g}; expected radians, up to 2 pi. Likely cause: they "
            "are in degrees."
        )
    pose = np.zeros((*numbers.shape[:-1], 4, 4))
    pose[..., :3, 3], pose[..., 3, 3] = numbers[..., :3], 1
    if np.isfinite(numbers).all():
        angles = numbers[..., 3:].reshape(-1, 3)
        turns = Rotation.from_euler("xyz", angles).as_matrix()
        pose[..., :3, :3] = turns.reshape(*numbers.shape[:-1], 3, 3)
    else:
        pose[..., :3, :3] = np.nan
    check_pose(where, pose)
    return pose


def placement_of(numbers: np.ndarray, where: str, source: str) -> Placement | None:
    """Where a camera stood in an episode, by DROID's numbers.

    Args:
        numbers: Of a camera, [6], or [T, 6] for each picture; what stands still becomes one pose.
        where: Whose they are, for messages.
        source: Where they are from, in words.

    Returns:
        None where they were never filled in: all are zero.

    Raises:
        CameraError: They are no poses, or their angles are in degrees.
    """
    numbers = np.asarray(numbers, np.float64)
    if not numbers.any():
        return None
    if numbers.ndim == 2 and len(numbers) and np.ptp(numbers, 0).max() <= STILL:
        numbers = numbers[0]
    return Placement(poses_of(numbers, where), source)
