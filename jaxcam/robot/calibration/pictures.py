"""Pictures to calibrate with, from a folder, from single files or from a video."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import av
import cv2
import numpy as np
from av.error import FFmpegError

from jaxcam.errors import DatasetError
from jaxcam.files.paths import absolute, read_bytes
from jaxcam.interrupts import check_stop

PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
VIDEOS = (".mp4", ".mkv", ".mov", ".avi", ".webm", ".m4v")
LARGEST = 1 << 28
"""Bytes of a picture's file."""
ANY_DEPTH = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH
FROM_VIDEO = 240
"""Pictures of a video that are looked at, evenly spaced."""
ODD = 0.02
"""Share of a quarter turn's numbers that the others of a display matrix may have: a degree."""


@dataclass(frozen=True)
class NamedPicture:
    """A picture and what to call it."""

    name: str
    """For messages: its file, and its number in a video."""
    rgb: np.ndarray = field(repr=False)
    """Uint8 [H, W, 3]."""

    @property
    def grey(self) -> np.ndarray:
        """Uint8 [H, W]."""
        return cv2.cvtColor(self.rgb, cv2.COLOR_RGB2GRAY)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.rgb.shape[1], self.rgb.shape[0]


def read_pictures(sources: Sequence[str]) -> Iterator[NamedPicture]:
    """Pictures of one camera, in order.

    Args:
        sources: A folder of pictures, pictures, or videos.

    Raises:
        DatasetError: There is none, one cannot be read, or their sizes differ.
    """
    first = None
    for picture in _all(sources):
        check_stop()
        first = first or picture
        if picture.size != first.size:
            one, other = ("{}x{}".format(*p.size) for p in (first, picture))
            raise DatasetError(
                f"{picture.name}: {other} pixels, but {first.name} has {one}. Pictures of one "
                "camera have one size: those of two cameras are mixed, or some were turned or "
                "scaled."
            )
        yield picture
    if first is None:
        raise DatasetError(f"{', '.join(sources)}: a video without a picture.")


def _all(sources: Sequence[str]) -> Iterator[NamedPicture]:
    for path in _files(sources):
        if path.suffix.lower() in VIDEOS:
            yield from _of_video(path)
        else:
            yield NamedPicture(path.name, _of_file(path))


def _files(sources: Sequence[str]) -> list[Path]:
    files = []
    for source in sources:
        path = absolute(source)
        if path.is_dir():
            inside = sorted(p for p in path.iterdir() if p.suffix.lower() in (*PICTURES, *VIDEOS))
            if not inside:
                raise DatasetError(
                    f"{path}: no picture and no video in this folder. Expected files that end in "
                    f"{', '.join((*PICTURES, *VIDEOS))}; folders inside it are not looked at."
                )
            files += inside
        elif not path.exists():
            raise DatasetError(f"{path}: no such file or folder.")
        else:
            files.append(path)
    return files


def _of_file(path: Path) -> np.ndarray:
    try:
        content = np.frombuffer(read_bytes(path, LARGEST), np.uint8)
    except OSError as error:
        raise DatasetError(f"{path} cannot be read: {error.strerror}.") from error
    try:
        picture = cv2.imdecode(content, ANY_DEPTH) if content.size else None
    except cv2.error:
        picture = None
    if picture is None or picture.dtype not in (np.uint8, np.uint16):
        raise DatasetError(
            f"{path}: no picture of 8 or 16 bits, or damaged. Expected PNG, JPEG or the like; "
            "take it out, or save it anew."
        )
    return cv2.cvtColor(_eight_bits(picture), cv2.COLOR_BGR2RGB)


def _eight_bits(picture: np.ndarray) -> np.ndarray:
    """A picture's levels as uint8; of 16 bits those that are used, which may be 10 or 12."""
    if picture.dtype == np.uint8:
        return picture
    return (picture >> max(0, int(picture.max()).bit_length() - 8)).astype(np.uint8)


def _of_video(path: Path) -> Iterator[NamedPicture]:
    """At most `FROM_VIDEO` pictures of a video, evenly spaced, turned as players show them."""
    try:
        with av.open(str(path)) as container:
            if not container.streams.video:
                raise DatasetError(f"{path}: no video in it.")
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            count = stream.frames or _count(path)
            stride = max(1, -(-count // FROM_VIDEO))
            for number, picture in enumerate(container.decode(stream)):
                if number % stride == 0:
                    yield NamedPicture(f"{path.name}, picture {number}", _as_shown(path, picture))
    except (FFmpegError, OSError) as error:
        raise DatasetError(
            f"{path}: a video that cannot be read, or damaged ({error.strerror})."
        ) from error


def _as_shown(path: Path, picture: av.VideoFrame) -> np.ndarray:
    """A video's picture as its display matrix says to show it: turned, mirrored, or as it is."""
    rgb = picture.to_ndarray(format="rgb24")
    matrix = picture.side_data.get("DISPLAYMATRIX")
    if matrix is None:
        return rgb
    a, b, _, c, d = np.frombuffer(matrix, np.int32)[:5].astype(float)
    small, large = sorted((np.abs([a, d]).max(), np.abs([b, c]).max()))
    if large == 0:  # it says nothing
        return rgb
    if small > ODD * large:
        raise DatasetError(
            f"{path}: players show this video turned by {-picture.rotation} degrees. Only quarter "
            "turns can be undone: save it anew, as it is to be seen."
        )
    right, down = (a, d) if abs(a) > abs(b) else (c, b)
    rgb = rgb if abs(a) > abs(b) else rgb.swapaxes(0, 1)
    return np.ascontiguousarray(rgb[:: -1 if down < 0 else 1, :: -1 if right < 0 else 1])


def _count(path: Path) -> int:
    with av.open(str(path)) as container:
        return sum(1 for packet in container.demux(video=0) if packet.size)
