"""H.264 videos that browsers play, and grids of rollout clips.

PyAV carries libx264 in its wheel, so nothing else has to be installed.
"""

import contextlib
import math
import sys
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from av.video.frame import VideoFrame
from av.video.reformatter import ColorPrimaries, ColorRange, Colorspace, ColorTrc
from av.video.stream import VideoStream

from jaxcam.files.whole import whole
from jaxcam.results.rows import Row

_BACKGROUND = (24, 26, 30)
_RUNNING = (96, 100, 108)
_TEXT = (232, 234, 237)
# Blue and vermilion of the Okabe-Ito set: told apart with every kind of colour vision.
_SUCCESS = (0, 158, 230)
_FAILURE = (213, 94, 0)

_TILE = 240  # smallest width of a tile, so that its caption can be read
_BORDER = 4
_BAR = 26
_GAP = 4


class VideoFile:
    """An H.264 mp4 that grows by pictures (yuv420p, BT.709, index first so that it plays early).

    The file appears under its name only when it is complete. Odd sizes, which 4:2:0 video cannot
    have, are made even by repeating the last row or column.

    Args:
        path: Where the video goes; folders are made.
        height: Of the pictures, in pixels.
        width: Of the pictures, in pixels.
        fps: Pictures a second.
        crf: Quality of libx264, 0 (lossless) to 51; 20 is hard to tell from the original.
        key_every: Pictures from one that stands alone to the next; libx264's own choice when None.
    """

    def __init__(
        self,
        path: str | Path,
        height: int,
        width: int,
        fps: float = 20,
        *,
        crf: int = 20,
        key_every: int | None = None,
    ) -> None:
        self.path = Path(path)
        self._place = contextlib.ExitStack()
        self.part = self._place.enter_context(whole(self.path))
        self.length = 0
        self._even = ((0, 0), (0, height % 2), (0, width % 2), (0, 0))
        options = {"movflags": "faststart"}
        self._container = av.open(str(self.part), "w", format="mp4", options=options)
        settings = {"crf": str(crf)} | ({"g": str(key_every)} if key_every else {})
        rate = Fraction(fps).limit_denominator(1001)
        stream = self._container.add_stream("libx264", rate=rate, options=settings)
        if not isinstance(stream, VideoStream):
            raise TypeError(f"libx264 opened a {type(stream).__name__}, expected a video stream")
        self._stream = stream
        stream.height, stream.width = height + height % 2, width + width % 2
        stream.pix_fmt = "yuv420p"
        # Without these tags a player guesses the colour matrix from the size of the picture.
        context = stream.codec_context
        context.colorspace, context.color_range = Colorspace.ITU709, ColorRange.MPEG
        context.color_primaries, context.color_trc = ColorPrimaries.BT709, ColorTrc.BT709
        self._place.enter_context(self._closing())

    def __enter__(self) -> "VideoFile":
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        self._place.__exit__(*(sys.exc_info() if kind is not None else (None, None, None)))

    @contextlib.contextmanager
    def _closing(self) -> Iterator[None]:
        try:
            yield
            self._container.mux(self._stream.encode())
        finally:
            self._container.close()

    def add(self, pictures: np.ndarray) -> None:
        """Appends pictures, uint8 [T, H, W, 3], RGB."""
        for rgb in np.pad(pictures, self._even, mode="edge"):
            picture = VideoFrame.from_ndarray(np.ascontiguousarray(rgb), format="rgb24")
            picture = picture.reformat(format="yuv420p", dst_colorspace="ITU709")
            self._container.mux(self._stream.encode(picture))
        self.length += len(pictures)


def write_video(path: str | Path, pictures: np.ndarray, fps: float = 20, *, crf: int = 20) -> Path:
    """Write a whole `VideoFile`.

    Args:
        path: Where the video goes; folders are made.
        pictures: At least one, uint8 [T, H, W, 3], RGB.
        fps: Pictures a second.
        crf: Quality of libx264, 0 (lossless) to 51.

    Returns:
        The path.
    """
    _check(pictures)
    with VideoFile(path, pictures.shape[1], pictures.shape[2], fps, crf=crf) as video:
        video.add(pictures)
    return Path(path)


def grid(
    videos: Sequence[np.ndarray],
    columns: int | None = None,
    *,
    rows: Sequence[Row] | None = None,
    hold: int = 20,
) -> np.ndarray:
    """Tile clips into one video; a clip that ends early stands still on its last picture.

    The border of a tile is grey while the clip runs and takes the colour of the outcome when it
    ends: blue for success, vermilion for failure.

    Args:
        videos: Clips, uint8 [T, H, W, 3], equal in height and width.
        columns: Tiles side by side; by default about as many as below one another.
        rows: Evaluation rows, one a clip, for the captions (pair, azimuth, elevation, outcome).
        hold: Pictures added at the end, so that the last outcome can be seen.

    Returns:
        Uint8 [T + hold, H', W', 3], T the length of the longest clip.
    """
    if not videos:
        raise ValueError("need at least one clip, got none")
    for clip in videos:
        _check(clip)
    sizes = {clip.shape[1:3] for clip in videos}
    if len(sizes) > 1:
        raise ValueError(f"clips must be equal in height and width, got {sorted(sizes)}")
    if rows is not None and len(rows) != len(videos):
        raise ValueError(f"need one row a clip, got {len(rows)} rows for {len(videos)} clips")
    scale = max(1, math.ceil((_TILE - 2 * _BORDER) / videos[0].shape[2]))
    height, width = (scale * size + 2 * _BORDER for size in videos[0].shape[1:3])
    height += _BAR if rows else 0
    columns = min(columns or math.ceil(math.sqrt(len(videos))), len(videos))
    lines = math.ceil(len(videos) / columns)
    length = max(len(clip) for clip in videos) + hold
    shape = (length, lines * (height + _GAP) + _GAP, columns * (width + _GAP) + _GAP, 3)
    canvas = np.full(shape, _BACKGROUND, np.uint8)
    for i, clip in enumerate(videos):
        top = _GAP + i // columns * (height + _GAP)
        left = _GAP + i % columns * (width + _GAP)
        tile = canvas[:, top : top + height, left : left + width]
        _fill_tile(tile, clip, scale, rows[i] if rows else None)
    return canvas


def _fill_tile(tile: np.ndarray, clip: np.ndarray, scale: int, row: Row | None) -> None:
    """Draw content, border and caption of each picture of one tile in place."""
    height, width = scale * clip.shape[1], scale * clip.shape[2]
    caption, outcome, colour = _describe(row)
    for t in range(min(len(clip) + 1, len(tile))):
        ended = t == len(clip)  # the picture after the clip has the colour of the outcome
        image = np.full(tile.shape[1:], colour if ended else _RUNNING, np.uint8)
        picture = clip[min(t, len(clip) - 1)]
        picture = cv2.resize(picture, (width, height), interpolation=cv2.INTER_CUBIC)
        image[_BORDER : _BORDER + height, _BORDER : _BORDER + width] = picture
        if row is not None:
            if not ended:
                image[_BORDER + height :] = _BACKGROUND
            _write(image, caption, outcome if ended else "")
        tile[t] = image
    tile[len(clip) + 1 :] = tile[min(len(clip), len(tile) - 1)]


def _describe(row: Row | None) -> tuple[str, str, tuple[int, int, int]]:
    """Caption, outcome and colour of the outcome."""
    if row is None:
        return "", "", _RUNNING
    caption = f"#{row.pair}"
    if row.azimuth_deg is not None and row.elevation_deg is not None:
        caption += f"  az {row.azimuth_deg:+.0f}  el {row.elevation_deg:.0f}"
    if not row.finished:
        return caption, "error", _RUNNING
    return (caption, "success", _SUCCESS) if row.success else (caption, "failed", _FAILURE)


def _write(tile: np.ndarray, caption: str, outcome: str) -> None:
    """Draw the caption at the left and the outcome at the right of the bar below the picture."""
    font, size, baseline = cv2.FONT_HERSHEY_SIMPLEX, 0.45, tile.shape[0] - 10
    width = cv2.getTextSize(outcome, font, size, 1)[0][0] if outcome else 0
    for text, left in ((caption, _BORDER + 4), (outcome, tile.shape[1] - _BORDER - 4 - width)):
        if text:
            cv2.putText(tile, text, (left, baseline), font, size, _TEXT, 1, cv2.LINE_AA)


def _check(pictures: np.ndarray) -> None:
    """Refuse what is not a video, in words."""
    if (
        pictures.ndim != 4
        or pictures.shape[-1] != 3
        or pictures.dtype != np.uint8
        or not pictures.size
    ):
        raise ValueError(
            f"pictures must be uint8 [T, H, W, 3] with T > 0, got {pictures.dtype} {pictures.shape}"
        )
