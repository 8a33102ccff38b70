"""Intrinsics of the cameras of a dataset, from what its file says."""

import numpy as np

from jaxcam.rays._camera import Camera


def intrinsics(fovy_deg: float, height: int, width: int | None = None) -> np.ndarray:
    """K of a picture whose principal point is its middle.

    Args:
        fovy_deg: Vertical field of view in degrees.
        height: Rows of the picture.
        width: Columns of it; as many as rows when None.

    Returns:
        Float64 `[3, 3]`, in pixels.

    Raises:
        CameraError: If there is no such field of view.
    """
    return np.asarray(Camera.from_fovy(np.deg2rad(fovy_deg), height, width or height).K)
