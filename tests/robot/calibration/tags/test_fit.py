"""A camera's pose from tags, against the pose that they were projected from."""

import numpy as np
import pytest
from tagged import OPTICS, SIZE, corners_seen, eye, tag_frames, tags_at

from jaxcam.errors import DatasetError
from jaxcam.robot.calibration.projection import apart
from jaxcam.robot.calibration.tags.fit import frame_of, locate, middle_corners, shifts


def off(pose, fit):
    place, turn = apart(pose, fit.base_from_camera)
    return 1000 * float(place), float(np.rad2deg(turn))


def test_several_tags_give_the_pose_and_how_sure_it_is():
    places, errors, sure = tag_frames(), [], []
    for seed in range(6):
        pose = eye(azimuth=seed, far=1.0)
        shown = corners_seen(pose, places, np.random.default_rng(seed))
        fit = locate(shown, tags_at(places), OPTICS)
        errors.append(off(pose, fit))
        sure.append((1000 * fit.spread[0], np.rad2deg(fit.spread[1])))
    median = np.median(errors, 0)
    assert median[0] < 2
    assert median[1] < 0.2
    ratio = median / np.median(sure, 0)
    assert ((ratio > 0.3) & (ratio < 3)).all()


def test_one_tag_from_the_side_is_enough():
    places = tag_frames((1,))
    pose = eye(elevation=0.6, far=0.5, aim=(0.15, 0.1, 0))
    fit = locate(
        corners_seen(pose, places, np.random.default_rng(0), 0.03), tags_at(places), OPTICS
    )
    place, turn = off(pose, fit)
    assert place < 6
    assert turn < 0.8


def test_one_tag_that_faces_the_camera_is_refused():
    places, pose = tag_frames((0,)), eye(elevation=1.35, far=2.0)
    shown = corners_seen(pose, places, np.random.default_rng(0))
    with pytest.raises(DatasetError, match=r"two poses.*second tag"):
        locate(shown, tags_at(places), OPTICS)


def test_a_tag_that_lies_elsewhere_does_not_count():
    places, pose = tag_frames(), eye()
    shown = corners_seen(pose, places, np.random.default_rng(0))
    places[3] = places[3].copy()
    places[3][:2, 3] += 0.03
    fit = locate(shown, tags_at(places), OPTICS)
    assert fit.dropped == (3,)
    assert fit.numbers == (0, 1, 2)
    assert off(pose, fit)[0] < 2


def test_another_size_than_the_file_says():
    places, pose = tag_frames(), eye()
    shown = corners_seen(pose, places, np.random.default_rng(0), size=0.1)
    with pytest.raises(DatasetError, match=r"80 mm, but look like (99|100|101) mm.*black square"):
        locate(shown, tags_at(places), OPTICS)


def test_tags_whose_places_nobody_knows():
    shown = corners_seen(eye(), tag_frames((2,)), np.random.default_rng(0))
    with pytest.raises(DatasetError, match=r"seen \[2\], known \[0\]"):
        locate(shown, tags_at(tag_frames((0,))), OPTICS)


def test_places_that_are_not_exact_make_the_pose_less_sure():
    places, pose = tag_frames(), eye()
    shown = corners_seen(pose, places, np.random.default_rng(0))
    spreads = [
        locate(shown, tags_at(places, accuracy=a), OPTICS).spread[0] for a in (0, 0.002, 0.004)
    ]
    assert spreads[0] < 0.0015 < spreads[1]
    assert spreads[2] / spreads[1] == pytest.approx(2, rel=0.2)


def test_medians_over_pictures_and_shifts_from_them():
    square = np.array([[0.0, 0], [9, 0], [9, 9], [0, 9]])
    pictures = [{0: square}, {0: square + 0.1, 1: square}, {0: square + 5}, {2: square}]
    middle = middle_corners(pictures[:3])
    np.testing.assert_allclose(middle[0], square + 0.1)
    far = shifts(pictures, middle)
    np.testing.assert_allclose(far[[0, 2]], np.sqrt(2) * np.array([0.1, 4.9]))
    assert np.isnan(far[3])


def test_the_axes_of_a_tag_are_those_of_its_corners():
    places = tag_frames()
    for number, corners in tags_at(places).corners.items():
        np.testing.assert_allclose(frame_of(corners), places[number], atol=1e-9)
        assert np.linalg.norm(corners[1] - corners[0]) == pytest.approx(SIZE)
