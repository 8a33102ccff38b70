"""Corners of drawn tags."""

import numpy as np
from tagged import FAMILY, OPTICS, corners_seen, drawn_tags, eye, tag_frames

from jaxcam.robot.calibration.boards import tags_in
from jaxcam.robot.calibration.tags.edges import refine_corners


def test_sides_give_corners_better_than_opencv_does():
    places = tag_frames()
    poses = [eye(azimuth=a, far=0.6) for a in (0.2, 2.0)]
    rough, fine = [], []
    for pose, picture in zip(poses, drawn_tags(poses, places), strict=True):
        true = corners_seen(pose, places, np.random.default_rng(0), noise=0)
        grey = np.ascontiguousarray(picture[..., 0])
        for number, corners in tags_in(grey, FAMILY):
            rough.append(corners - true[number])
            fine.append(refine_corners(grey, corners, 8, OPTICS) - true[number])
    assert len(fine) >= 6
    assert np.sqrt(np.mean(np.square(fine))) < 0.15
    assert np.sqrt(np.mean(np.square(fine))) < 0.6 * np.sqrt(np.mean(np.square(rough)))


def test_where_nothing_is_corners_stay():
    grey = np.full((240, 320), 128, np.uint8)
    corners = np.array([[100.0, 80], [140, 80], [140, 120], [100, 120]])
    np.testing.assert_array_equal(refine_corners(grey, corners, 8, OPTICS), corners)
