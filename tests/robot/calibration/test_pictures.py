"""Pictures from folders, files and videos."""

import cv2
import numpy as np
import pytest

from jaxcam.errors import DatasetError
from jaxcam.files.video import write_video
from jaxcam.robot.calibration.pictures import read_pictures


def picture(level=50, size=(24, 32)):
    shown = np.zeros((*size, 3), np.uint8)
    shown[..., 0] = level
    return shown


def test_a_folder_in_order_with_its_colours(tmp_path):
    for name, level in (("b.jpg", 200), ("a.png", 50)):
        cv2.imwrite(str(tmp_path / name), picture(level)[..., ::-1])
    (tmp_path / "notes.txt").write_text("not a picture")
    pictures = list(read_pictures([str(tmp_path)]))
    assert [p.name for p in pictures] == ["a.png", "b.jpg"]
    assert pictures[0].rgb[0, 0].tolist() == [50, 0, 0]
    assert pictures[0].size == (32, 24)
    assert pictures[0].grey.shape == (24, 32)


def test_a_video_is_looked_at_evenly(tmp_path):
    write_video(tmp_path / "a.mp4", np.stack([picture(10 * i) for i in range(12)]))
    pictures = list(read_pictures([str(tmp_path / "a.mp4")]))
    assert len(pictures) == 12
    assert pictures[3].name == "a.mp4, picture 3"


@pytest.mark.parametrize(
    ("name", "content", "match"),
    [("a.png", b"no picture", "no picture, or damaged"), ("a.png", b"", "no picture, or damaged"),
     ("a.mp4", b"no video", "cannot be read, or damaged")],
)  # fmt: skip
def test_what_cannot_be_read(tmp_path, name, content, match):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DatasetError, match=match):
        list(read_pictures([str(tmp_path)]))


def test_pictures_of_two_sizes(tmp_path):
    for name, size in (("a.png", (24, 32)), ("b.png", (32, 24))):
        cv2.imwrite(str(tmp_path / name), picture(size=size))
    with pytest.raises(
        DatasetError, match=r"b\.png: 24x32 pixels, but a\.png has 32x24.*two cameras"
    ):
        list(read_pictures([str(tmp_path)]))


def test_nothing_there(tmp_path):
    with pytest.raises(DatasetError, match="no picture and no video"):
        list(read_pictures([str(tmp_path)]))
    with pytest.raises(DatasetError, match="no such file"):
        list(read_pictures([str(tmp_path / "none")]))
