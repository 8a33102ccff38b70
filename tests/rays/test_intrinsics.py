"""Intrinsics from a field of view."""

import numpy as np

from jaxcam.rays import Camera
from jaxcam.rays.intrinsics import intrinsics


def test_intrinsics_are_of_the_whole_picture():
    camera = Camera(intrinsics(45, 84), np.eye(4), 84, 84).validate()
    np.testing.assert_allclose(np.rad2deg(camera.fovy), 45, rtol=1e-6)
    np.testing.assert_allclose(intrinsics(45, 84)[:2, 2], 42)
