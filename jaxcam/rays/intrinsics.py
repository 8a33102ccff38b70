"""Intrinsics of the cameras of a dataset, from what its file says."""

import numpy as np

from jaxcam.rays._camera import Camera


def intrinsics(fovy_deg: float, resolution: int) -> np.ndarray:
    """K of a square picture whose principal point is its middle.

    Args:
        fovy_deg: Vertical field of view in degrees.
        resolution: Side of the picture in pixels.

    Returns:
        Float64 `[3, 3]`, in pixels.

    Raises:
        CameraError: If there is no such field of view.
    """
    return np.asarray(Camera.from_fovy(np.deg2rad(fovy_deg), resolution, resolution).K)
