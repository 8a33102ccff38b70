"""DROID's videos: one MP4 a camera, whose n-th picture is of the n-th step."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np
from av.error import FFmpegError

from jaxcam.data.hdf5 import require_file
from jaxcam.errors import DatasetError
from jaxcam.interop.lerobot.recorded.videos import identity_of_video


@dataclass(frozen=True)
class Video:
    """A video that was looked at, but not decoded."""

    path: Path
    """Of the file."""
    height: int
    """Rows of a picture."""
    width: int
    """Columns of a picture."""
    length: int | None
    """Pictures, by what the file says; None where it does not."""
    identity: bytes
    """What tells it from another."""


def open_video(path: Path) -> Video:
    """Looks at a video.

    Args:
        path: Of the file, an MP4.

    Raises:
        DatasetError: There is none, or it is damaged.
    """
    require_file(path)
    size = path.stat().st_size
    try:
        with av.open(str(path), format="mp4") as container:
            stream = container.streams.video[0]
            height, width, length = stream.height, stream.width, stream.frames
            end = max((entry.pos + entry.size for entry in stream.index_entries), default=0)
    except (FFmpegError, IndexError, AttributeError) as error:
        raise DatasetError(
            f"{path}: no MP4 with a video that can be decoded ({size} bytes): "
            f"{getattr(error, 'strerror', error)}. Copy it again."
        ) from error
    if end > size:
        raise DatasetError(
            f"{path}: truncated: {size} bytes, expected {end} at least. Copy it again."
        )
    return Video(path, height, width, length or None, identity_of_video(path))


def decode_video(video: Video, steps: np.ndarray, where: str) -> Iterator[np.ndarray]:
    """The pictures of some steps, in order; uint8 [height, width, 3], top row first.

    Args:
        video: Which was looked at.
        steps: Numbers of pictures, ascending [T].
        where: Of which episode, for messages.

    Raises:
        DatasetError: The file is damaged, or ends before the last of them.
    """
    wanted, count = {int(step) for step in steps}, 0
    last = max(wanted, default=-1)
    try:
        with av.open(str(video.path), format="mp4") as container:
            for picture in container.decode(video=0):
                if count in wanted:
                    yield picture.to_ndarray(format="rgb24")
                count += 1
                if count > last:
                    return
    except (FFmpegError, IndexError) as error:
        raise DatasetError(
            f"{video.path}, {where}: cannot be decoded after {count} pictures: "
            f"{getattr(error, 'strerror', error)}. Copy it again."
        ) from error
    raise DatasetError(
        f"{video.path}, {where}: ends after {count} pictures, expected {last + 1}. Copy it again."
    )
