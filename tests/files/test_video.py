"""Videos are decoded again and compared with what was written."""

import av
import numpy as np
import pytest

from jaxcam.files.video import grid, write_video
from jaxcam.results.rows import Row

RED, GREEN, BLUE = (200, 30, 30), (30, 180, 60), (20, 40, 210)


def clip(colour, length, height=48, width=64):
    return np.full((length, height, width, 3), colour, np.uint8)


def decode(path):
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        pictures = [f.to_ndarray(format="rgb24") for f in container.decode(stream)]
        return np.stack(pictures), stream.codec_context, stream.average_rate


def test_round_trip_keeps_count_size_rate_and_colours(tmp_path):
    pictures = np.concatenate([clip(RED, 5), clip(GREEN, 5), clip(BLUE, 5)])
    decoded, codec, rate = decode(write_video(tmp_path / "deep" / "a.mp4", pictures, fps=20))
    assert decoded.shape == pictures.shape
    assert (codec.name, codec.pix_fmt, float(rate)) == ("h264", "yuv420p", 20.0)
    assert np.abs(decoded.astype(int) - pictures).max() <= 12
    assert list(tmp_path.rglob("*.part")) == []


def test_index_comes_before_the_pictures(tmp_path):
    data = write_video(tmp_path / "a.mp4", clip(RED, 3)).read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")


def test_a_player_is_told_the_colour_matrix(tmp_path):
    _, codec, _ = decode(write_video(tmp_path / "a.mp4", clip(RED, 3)))
    assert (int(codec.colorspace), int(codec.color_range)) == (1, 1)  # BT.709, limited range


def test_odd_sizes_become_even(tmp_path):
    decoded, _, _ = decode(write_video(tmp_path / "a.mp4", clip(GREEN, 2, 33, 41)))
    assert decoded.shape == (2, 34, 42, 3)
    assert np.abs(decoded[:, -1].astype(int) - GREEN).max() <= 12


@pytest.mark.parametrize(
    "pictures",
    [np.zeros((2, 8, 8, 3)), np.zeros((8, 8, 3), np.uint8), np.zeros((0, 8, 8, 3), np.uint8)],
)
def test_what_is_not_a_video_is_refused_and_leaves_the_old_file(tmp_path, pictures):
    path = tmp_path / "a.mp4"
    path.write_bytes(b"old")
    with pytest.raises(ValueError, match="uint8"):
        write_video(path, pictures)
    assert path.read_bytes() == b"old"


def row(pair, success, **fields):
    angles = {"azimuth_deg": -31.4, "elevation_deg": 44.6}
    return Row(pair=pair, success=success, status="ok", **{**angles, **fields})


def test_short_clips_stand_still_and_show_their_outcome():
    short, long = clip(GREEN, 3), clip(RED, 10)
    short[-1] = BLUE
    tiled = grid([short, long], columns=2, rows=[row(0, True), row(1, False)], hold=4)
    assert len(tiled) == 14
    half = tiled.shape[2] // 2
    left, right = tiled[:, :, :half], tiled[:, :, half:]
    centre = (tiled.shape[1] // 3, half // 2)
    assert tuple(left[0][centre]) == GREEN
    assert tuple(left[2][centre]) == tuple(left[-1][centre]) == BLUE
    assert tuple(right[-1][centre]) == RED
    running, success = left[2, 5, half // 2], left[3, 5, half // 2]
    assert success[2] > success[0] + 100  # blue
    assert np.ptp(running.astype(int)) < 20  # grey
    assert np.ptp(right[9, 5, half // 2].astype(int)) < 20
    failed = right[10, 5, half // 2].astype(int)
    assert failed[0] > failed[2] + 100  # vermilion


def test_caption_names_the_pair():
    plain = [clip(GREEN, 1)] * 2
    captions = [row(1, True), row(8, True)]
    tiled = grid(plain, columns=2, rows=captions, hold=0)[0]
    half = tiled.shape[1] // 2
    first, second = tiled[:, 4:half], tiled[:, half + 2 :]
    assert np.any(first[-28:, :60] > 200)  # light letters on the bar
    assert not np.array_equal(first[-28:, :60], second[-28:, :60])


def test_grid_is_about_square_and_pads_with_background():
    tiled = grid([clip(RED, 2, 200, 300)] * 5, hold=0)
    lines, columns = tiled.shape[1] // 200, tiled.shape[2] // 300
    assert (lines, columns) == (2, 3)
    assert np.ptp(tiled[0, -100, -150].astype(int)) < 20  # no sixth clip


def test_grid_refuses_what_does_not_fit_together():
    with pytest.raises(ValueError, match="at least one"):
        grid([])
    with pytest.raises(ValueError, match="equal in height"):
        grid([clip(RED, 2), clip(RED, 2, 10, 10)])
    with pytest.raises(ValueError, match="2 rows for 1 clips"):
        grid([clip(RED, 2)], rows=[row(0, True), row(1, True)])
