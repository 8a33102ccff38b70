"""Pictures from folders, files and videos."""

import struct

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


QUARTER = {"right": (0, 1, -1, 0), "half": (-1, 0, 0, -1), "left": (0, -1, 1, 0),
           "mirrored": (-1, 0, 0, 1), "over": (1, 0, 0, -1), "swapped": (0, 1, 1, 0),
           "says nothing": (0, 0, 0, 0), "nearly right": (0.001, 1, -1, 0.001)}  # fmt: skip


def filmed(path, picture, matrix):
    """A video of a picture that players show turned or mirrored; phones store both."""
    write_video(path, np.stack([picture] * 3))
    content = path.read_bytes()
    at = content.index(b"tkhd") + 4 + 4 + 5 * 4 + 4 * 4  # version, times, duration; layers, volume
    a, b, c, d = (round(x * (1 << 16)) for x in matrix)
    shown = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path.write_bytes(content[:at] + shown + content[at + 36 :])
    return path


@pytest.mark.parametrize(
    ("way", "shown"),
    [("right", np.s_[::-1, :]), ("half", np.s_[::-1, ::-1]), ("left", np.s_[:, ::-1]),
     ("mirrored", np.s_[:, ::-1]), ("over", np.s_[::-1, :]), ("swapped", np.s_[:, :]),
     ("says nothing", np.s_[:, :]), ("nearly right", np.s_[::-1, :])],
)  # fmt: skip
def test_videos_are_shown_as_players_show_them(tmp_path, way, shown):
    stored = np.zeros((32, 48, 3), np.uint8)
    stored[:16, :24], stored[:16, 24:] = 255, 128
    expected = stored[shown]
    if way in ("right", "left", "swapped", "nearly right"):
        expected = expected.swapaxes(0, 1)
    (first, *_) = read_pictures([str(filmed(tmp_path / "a.mp4", stored, QUARTER[way]))])
    assert first.rgb.shape == expected.shape
    assert np.abs(first.rgb.astype(int) - expected).mean() < 12


def test_a_video_that_is_shown_at_an_odd_angle_is_refused(tmp_path):
    turned = np.float64([1, 1, -1, 1]) / np.sqrt(2)
    path = filmed(tmp_path / "a.mp4", picture(size=(24, 32)), turned)
    with pytest.raises(DatasetError, match=r"turned by 45 degrees. Only quarter turns"):
        next(read_pictures([str(path)]))


@pytest.mark.parametrize("bits", [12, 16])
def test_deeper_pictures_have_their_own_levels(tmp_path, bits):
    levels = np.linspace(0, 1, 32)[None].repeat(24, 0) * (2**bits - 1)
    cv2.imwrite(str(tmp_path / "a.tiff"), levels.astype(np.uint16))
    (shown,) = read_pictures([str(tmp_path)])
    assert shown.rgb.dtype == np.uint8
    np.testing.assert_allclose(shown.grey[0], np.linspace(0, 255, 32), atol=1.5)


@pytest.mark.parametrize(
    ("name", "content", "match"),
    [("a.png", b"no picture", "no picture.* or damaged"), ("a.png", b"", "no picture.* or damaged"),
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
