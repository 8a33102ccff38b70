"""Files of tags."""

import json

import numpy as np
import pytest

from jaxcam.errors import CameraError, ConfigError, DatasetError
from jaxcam.robot.calibration.tags.places import read_tags

FLAT = {"position": [0.4, 0.1, 0], "quaternion_wxyz": [1, 0, 0, 0]}
CORNERS = [[0, 0.08, 0], [0.08, 0.08, 0], [0.08, 0, 0], [0, 0, 0]]


def written(folder, tags, **more):
    path = folder / "tags.json"
    content = {"format": 1, "family": "36h11", "size": 0.08, "tags": tags} | more
    path.write_text(json.dumps({k: v for k, v in content.items() if v is not None}))
    return path


def test_poses_and_touched_corners(tmp_path):
    tags = read_tags(
        written(tmp_path, {"0": {"base_from_tag": FLAT}, "5": {"corners": CORNERS}}, accuracy=0.001)
    )
    np.testing.assert_allclose(tags.corners[0][0], [0.36, 0.14, 0])
    np.testing.assert_allclose(tags.corners[0][2], [0.44, 0.06, 0])
    np.testing.assert_allclose(tags.corners[5], CORNERS)
    assert tags.sizes == {0: 0.08, 5: 0.08}
    assert tags.accuracy == 0.001


@pytest.mark.parametrize(
    ("tags", "more", "match"),
    [
        ({"0": {"base_from_tag": FLAT}}, {"family": "36h12"}, "did you mean '36h11'"),
        ({"0": {"base_from_tag": FLAT}}, {"size": None}, "'size' is the side of its black square"),
        ({"0": {"base_from_tag": FLAT}}, {"size": 80}, "in metres"),
        ({"0": {"base_from_tag": FLAT}}, {"format": 2}, "format 2; expected 1"),
        ({"0": {"base_from_tag": FLAT}}, {"accuracy": -1.0}, "accuracy"),
        ({"front": {"base_from_tag": FLAT}}, {}, "numbers 0 to 586"),
        ({"900": {"base_from_tag": FLAT}}, {}, "numbers 0 to 586"),
        ({"0": {"base_from_tag": FLAT, "corners": CORNERS}}, {}, "either"),
        ({"0": {}}, {}, "either"),
        ({"0": {"pose": FLAT}}, {}, "Unknown setting 'pose'"),
        ({"0": {"corners": CORNERS[:3]}}, {}, "four points"),
        ({"0": {"corners": CORNERS}}, {"size": 0.1}, "80 mm; expected a square of 100"),
        ({"0": {"corners": [CORNERS[i] for i in (0, 2, 1, 3)]}}, {}, "another order"),
        ({"0": {"base_from_tag": {**FLAT, "quaternion_wxyz": [1, 1, 0, 0]}}}, {}, "length 1"),
        ({}, {}, "no tag"),
    ],
)  # fmt: skip
def test_what_means_nothing_is_refused(tmp_path, tags, more, match):
    with pytest.raises((ConfigError, CameraError), match=match):
        read_tags(written(tmp_path, tags, **more))


def test_no_file(tmp_path):
    with pytest.raises(DatasetError, match="no such file"):
        read_tags(tmp_path / "tags.json")
