"""Videos of several codecs and times, and videos that are damaged."""

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="jaxcam[lerobot] is not installed")

from lerobot_datasets import (
    HEIGHT,
    LENGTHS,
    RATE,
    TOP,
    check_pictures,
    data_file,
    edit_table,
    picture,
    psnr,
    refused,
    shown,
    video_file,
    write_folder,
    write_mp4,
)

from jaxcam.errors import ConfigError, DatasetError
from jaxcam.files.video import write_video
from jaxcam.interop.lerobot.reading import read_lerobot


@pytest.mark.parametrize(
    ("codec", "options"), [("libx264", {"g": "2"}), ("libx265", {}), ("libsvtav1", {"g": "2"})]
)
def test_codecs(tmp_path, codec, options):
    made = write_folder(tmp_path / "x", codec=codec, options=options, keys=(TOP,))
    check_pictures(read_lerobot(tmp_path / "x"), made, 30)


def test_a_videos_own_times(tmp_path):
    made = write_folder(tmp_path / "x", start=0.35, keys=(TOP,))
    check_pictures(read_lerobot(tmp_path / "x"), made)


def test_a_video_of_another_rate_gives_the_nearest_pictures(copied):
    root = copied("v2.1")
    pictures = [picture(0, t // 2 if t % 2 == 0 else 9, 0) for t in range(2 * LENGTHS[0])]
    write_mp4(video_file(root), pictures, rate=2 * RATE)
    decoded = shown(read_lerobot(root).episodes[0])
    assert psnr(decoded, np.stack([picture(0, t, 0) for t in range(LENGTHS[0])])) > 35


def test_pictures_at_uneven_times(copied):
    """Of such videos the index, which has times of decoding, does not tell when each is shown."""
    root = copied("v2.1")
    moments = np.array([0, 1, 4, 5, 11, 12])
    edit_table(data_file(root), timestamp=(moments / RATE).astype(np.float32))
    pictures = [picture(0, t, 0) for t in range(LENGTHS[0])]
    for file in sorted((root / "videos").rglob("*_000000.mp4")):
        write_mp4(file, pictures, "libx265", moments=moments)
    assert psnr(shown(read_lerobot(root).episodes[0]), np.stack(pictures)) > 30


def test_colours_of_a_video_that_says_how_they_are_coded(tmp_path):
    """BT.709 read as BT.601 would be up to 23 levels off, as LeRobot's with PyAV 15 are."""
    colours = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (200, 120, 40)]
    bars = np.repeat(np.array([colours], np.uint8), 16, axis=1).repeat(HEIGHT, axis=0)
    root = tmp_path / "x"
    write_folder(root, "v2.1", keys=(TOP,))
    write_video(video_file(root), np.stack([bars] * LENGTHS[0]), RATE, crf=5)
    middle = shown(read_lerobot(root).episodes[0])[3, HEIGHT // 2, 8::16]
    np.testing.assert_allclose(middle.astype(int), colours, atol=3)


def test_a_video_that_is_cut_short(copied):
    root = copied()
    path = video_file(root)
    content = path.read_bytes()
    path.write_bytes(content[:-40])
    message = refused(root, r"mp4 is cut short: .* first those of episode 1 of view 'top'")
    assert str(path) in message
    path.write_bytes(content[:300])
    refused(root, r"file-000\.mp4 (cannot be|has no video).*\(episode 0 of view 'top'")
    path.write_bytes(b"")
    refused(root, r"file-000\.mp4 cannot be decoded")
    path.write_bytes(b"no video at all" * 100)
    refused(root, r"file-000\.mp4 cannot be decoded")


def test_a_codec_that_cannot_be_decoded(copied):
    root = copied()
    path = video_file(root)
    path.write_bytes(path.read_bytes().replace(b"avc1", b"xyz1").replace(b"avcC", b"xyzC"))
    refused(root, r"file-000\.mp4 is coded in a way that PyAV [\d.]+ cannot decode .*episode 0")


def test_a_video_that_is_damaged_within(copied):
    root = copied("v2.1")
    path = video_file(root)
    content = bytearray(path.read_bytes())
    for i in range(content.index(b"mdat") + 700, len(content)):
        content[i] ^= 0x5A
    path.write_bytes(content)
    with pytest.raises(DatasetError, match=r"episode_000000\.mp4.*episode 0 of view 'top'"):
        shown(read_lerobot(root).episodes[0])


def test_times_that_do_not_fit(copied):
    root = copied()
    times = [t / 15 for t in range(6)] + [t / RATE for t in range(4)]
    edit_table(data_file(root), timestamp=times)
    words = r"episode 0 of view 'top': no picture for step 1 at 0\.0667 s; the nearest is 0\.0167 s"
    refused(root, words)
    assert shown(read_lerobot(root, tolerance=0.02).episodes[0]).shape[0] == LENGTHS[0]
    for tolerance in (0.025, 0.0, float("nan")):
        with pytest.raises(ConfigError, match="tolerance is more than 0 and less than half a step"):
            read_lerobot(root, tolerance=tolerance)


def test_too_few_pictures(copied):
    root = copied()
    write_mp4(video_file(root), [picture(0, t, 0) for t in range(7)])
    refused(root, r"episode 1 of view 'top': no picture for step 1 at .* has 7 pictures from 0\.0")
