"""Points, poses and pixels."""

import numpy as np
from seen_boards import WIDE, optics

from jaxcam.rays import Camera
from jaxcam.robot.calibration.projection import (
    BEHIND,
    apart,
    moved,
    pixels_of,
    placed,
    pose_of,
    spread_of,
    straightened,
)


def test_pixels_are_those_of_the_cameras_rays():
    camera, points = optics(), np.array([[0.1, 0.05, 1.0], [-0.2, 0.1, 0.8]])
    record = Camera(camera.K, np.eye(4), 480, 640, camera.distortion)
    np.testing.assert_allclose(pixels_of(points, camera), record.project(points)[0], atol=1e-3)
    assert (pixels_of(np.array([[0.0, 0, -1]]), camera) == BEHIND).all()


def test_straightening_undoes_projection():
    for camera in (optics(), optics(300.0, WIDE, "fisheye")):
        points = np.array([[0.3, -0.2, 1.0], [0.0, 0.25, 1.0]])
        back = straightened(pixels_of(points, camera), camera)
        np.testing.assert_allclose(back, points[:, :2], atol=1e-9)


def test_poses_move_in_their_own_axes_and_know_how_far():
    pose = pose_of(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]), np.array([1.0, 2, 3]))
    after = moved(pose, np.array([0.1, 0, 0, 0, 0, 0.2]))
    np.testing.assert_allclose(after[:3, 3], [1, 2.1, 3])
    np.testing.assert_allclose(apart(pose, after), (0.1, 0.2), atol=1e-7)
    np.testing.assert_allclose(placed(pose, np.array([[1.0, 0, 0]])), [[1, 3, 3]])
    spread = spread_of(np.diag([1, 4, 9, 0.01, 0.04, 0.25]))
    np.testing.assert_allclose(spread, (3, 0.5))
