"""Tags in pictures, and pictures that do not belong together."""

import numpy as np
import pytest
from tagged import FAMILY, HEIGHT, OPTICS, WIDTH, corners_seen, drawn_tags, eye, tag_frames

from jaxcam.errors import DatasetError
from jaxcam.robot.calibration.pictures import NamedPicture
from jaxcam.robot.calibration.tags.pictures import TagSights, standing, tag_sights

SIZE = WIDTH, HEIGHT


@pytest.fixture(scope="module")
def picture():
    return NamedPicture("a.png", drawn_tags([eye(far=0.6)], tag_frames())[0])


def test_known_tags_are_found(picture):
    grey = NamedPicture("b.png", np.full_like(picture.rgb, 90))
    sights = tag_sights([picture, grey], FAMILY, (0, 1, 2), OPTICS, "view 'front'")
    assert sights.names == ("a.png",)
    assert sights.without == ("b.png",)
    assert set(sights.middle) <= {0, 1, 2}
    assert len(sights.middle) >= 2


@pytest.mark.parametrize(
    ("change", "family", "known", "match"),
    [
        (lambda p: p * 0 + 90, FAMILY, (0,), r"no tag 0 of the family 36h11.*a\.png.*20 pixels"),
        (lambda p: p[:, ::-1], FAMILY, (0, 1, 2, 3), "mirrored"),
        (lambda p: p, "25h9", (0,), "family 36h11 are there"),
        (lambda p: p, FAMILY, (40, 41), r"Other tags are there: .*known are 40, 41"),
    ],
)
def test_no_tag_says_why(picture, change, family, known, match):
    other = NamedPicture("a.png", np.ascontiguousarray(change(picture.rgb)))
    with pytest.raises(DatasetError, match=match):
        tag_sights([other], family, known, OPTICS, "view 'front'")


def sights(poses):
    rng, places = np.random.default_rng(0), tag_frames()
    corners = tuple(corners_seen(pose, places, rng) for pose in poses)
    names = tuple(f"{i}.png" for i in range(len(poses)))
    return TagSights(names, corners, np.zeros((2, 2, 3), np.uint8))


def test_a_camera_that_moved_is_refused_with_the_first_picture():
    here, there = eye(), eye(azimuth=0.43)
    with pytest.raises(DatasetError, match=r"moved, or .* two cameras.*from 4\.png on"):
        standing(sights([here] * 4 + [there] * 4), SIZE, "view 'front'")


def test_a_picture_of_something_else_is_left_out():
    still, notes = standing(sights([eye()] * 7 + [eye(azimuth=0.6)]), SIZE, "view 'front'")
    assert still.names == tuple(f"{i}.png" for i in range(7))
    assert "7.png" in notes[0]
    whole, notes = standing(sights([eye()] * 3), SIZE, "view 'front'")
    assert len(whole.names) == 3
    assert notes == []
