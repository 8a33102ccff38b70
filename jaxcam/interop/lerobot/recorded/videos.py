"""Pictures in videos, found by their times, decoded with PyAV.

A step's picture is the one whose time in the file is nearest to where the episode begins in it plus
the step's timestamp. Times count in the stream's own time base.
"""

import contextlib
import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np
from av.container import InputContainer
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from jaxcam.errors import DatasetError

_ENDS = 65536
"""Bytes of a video's start and of its end that tell which one it is."""
_STEPS_BACK = (0.0, 1.0, 4.0, 16.0, 64.0, float("inf"))
"""Seconds before a wanted picture to look for one that stands alone, tried in turn."""


@dataclass(frozen=True)
class VideoClip:
    """What one camera saw of one episode, in a video."""

    view: str
    """The camera's name."""
    file: Path
    times: np.ndarray
    """When in the file each step's picture is (s), rising, float64 [T]."""
    tolerance: float
    """What the time of a picture may be off (s)."""
    episode: str
    """Its name, for messages."""

    @property
    def what(self) -> str:
        """For messages that name the file."""
        return f"{self.episode} of view '{self.view}'"

    @property
    def about(self) -> str:
        """For other messages."""
        return f"{self.file}, {self.what}"


def check_video(file: Path, clips: Sequence[VideoClip]) -> tuple[int, int]:
    """Refuses a video that does not have the pictures of its episodes, without decoding it.

    The sizes, places and times of all pictures are in the file's index, which is read alone.

    Args:
        file: The video.
        clips: The episodes in it, at least one.

    Returns:
        Height and width of its pictures.

    Raises:
        DatasetError: It is missing or cut short, its codec cannot be decoded, or a picture is
            missing at the time of a step.
    """
    first = clips[0].what
    container, stream = _open(file, first)
    with container:
        _check_whole(file, stream, clips)
        if not _fit(_indexed_times(stream), clips):
            # the index has times of decoding: those of showing are the same where they are regular
            with _naming(file, first):
                times = sorted(p.pts for p in container.demux(stream) if p.pts is not None)
                container.seek(0)
            _check_times(np.array(times) * float(stream.time_base or 1), clips)
        with _naming(file, first):
            shown = next(container.decode(stream), None)
        if shown is None:
            raise DatasetError(f"{file} has no pictures ({first}).")
        return shown.height, shown.width


def identity(file: Path) -> bytes:
    """What tells a video from another: its size, its start and its end.

    The index of all pictures' sizes and places is at the start or at the end of a video, so one of
    other pictures, or of the same ones coded anew, differs there. All of a large dataset's videos
    would take as long to read as to import.

    Args:
        file: The video.
    """
    size = file.stat().st_size
    with open(file, "rb") as data:
        ends = data.read(_ENDS)
        data.seek(max(0, size - _ENDS))
        ends += data.read(_ENDS)
    return hashlib.sha256(ends + size.to_bytes(8, "little")).digest()


class VideoReader:
    """An open video that is decoded forwards.

    Args:
        clip: An episode in it.
    """

    def __init__(self, clip: VideoClip) -> None:
        self.file = clip.file
        self._container, self._stream = _open(clip.file, clip.what)
        self._stream.thread_type = "AUTO"
        self._base = float(self._stream.time_base or 1)
        self._frames: Iterator[VideoFrame] = iter(())
        self._now: VideoFrame | None = None
        self._next: VideoFrame | None = None

    def close(self) -> None:
        """Lets the file go."""
        self._container.close()

    def pictures(self, clip: VideoClip) -> Iterator[np.ndarray]:
        """An episode's pictures, uint8 [H, W, 3].

        Raises:
            DatasetError: They cannot be decoded, or one is missing at the time of a step.
        """
        with _naming(self.file, clip.what):
            if not self._is_just_before(clip):
                self._seek(clip)
            for step, time in enumerate(clip.times):
                while self._next is not None and self._off(self._next, time) < self._off(
                    self._now, time
                ):
                    self._advance()
                off = self._off(self._now, time)
                if self._now is None or off > clip.tolerance:
                    raise DatasetError(
                        f"{clip.about}: no picture for step {step} at {time:.4f} s; the nearest is "
                        f"{off:.4f} s away, {clip.tolerance:.4f} s at most were expected. The file "
                        "may be damaged."
                    )
                if self._now.is_corrupt:
                    raise DatasetError(f"{clip.about}: the picture of step {step} is damaged.")
                yield self._now.to_ndarray(format="rgb24")

    def _off(self, frame: VideoFrame | None, time: float) -> float:
        return float("inf") if frame is None else abs((frame.pts or 0) * self._base - time)

    def _advance(self) -> None:
        self._now = self._next
        self._next = next((f for f in self._frames if f.pts is not None), None)

    def _is_just_before(self, clip: VideoClip) -> bool:
        """Whether an episode is reached soonest by reading on."""
        wanted = clip.times[0] + clip.tolerance
        if self._now is None or self._next is None or (self._now.pts or 0) * self._base > wanted:
            return False
        entries = self._stream.index_entries
        alone = entries.search_timestamp(int(wanted / self._base), backward=True)
        return alone >= 0 and entries[alone].timestamp <= (self._next.pts or 0)

    def _seek(self, clip: VideoClip) -> None:
        """Goes to a picture at or before an episode's first, from which on all can be decoded.

        A key that follows pictures which are shown after it takes its place in time among them, so
        the first key that is found can be too late.
        """
        for back in _STEPS_BACK:
            target = max(0.0, clip.times[0] + clip.tolerance - back)
            self._container.seek(int(target / self._base), stream=self._stream, backward=True)
            self._frames = self._container.decode(self._stream)
            self._advance()
            self._advance()
            if self._now and (self._now.pts or 0) * self._base <= clip.times[0] + clip.tolerance:
                return


def _open(file: Path, about: str) -> tuple[InputContainer, VideoStream]:
    """A video and the stream of its pictures."""
    if not file.is_file():
        raise DatasetError(f"{file} is missing ({about}). Was the dataset copied in part?")
    with contextlib.ExitStack() as place:
        with _naming(file, about):
            container = place.enter_context(av.open(str(file)))
        if not container.streams.video:
            raise DatasetError(f"{file} has no video in it ({about}).")
        stream = container.streams.video[0]
        if stream.codec_context is None or stream.time_base is None:
            raise DatasetError(
                f"{file} is coded in a way that PyAV {av.__version__} cannot decode ({about}). "
                "Code it anew as H.264, HEVC or AV1."
            )
        place.pop_all()  # whoever asked closes it
        return container, stream


@contextlib.contextmanager
def _naming(file: Path, about: str) -> Iterator[None]:
    """Says of which video and episode an error of FFmpeg's is."""
    try:
        yield
    except (av.FFmpegError, ValueError, EOFError) as error:
        if isinstance(error, DatasetError):
            raise
        raise DatasetError(
            f"{file} cannot be decoded: {error} ({about}). It may be cut short or damaged."
        ) from error


def _check_whole(file: Path, stream: VideoStream, clips: Sequence[VideoClip]) -> None:
    """Refuses a file that ends before its pictures do."""
    size, base = file.stat().st_size, float(stream.time_base or 1)
    cut = [e.timestamp * base for e in stream.index_entries if e.pos + e.size > size]
    if cut:
        lost = next((c for c in clips if c.times[-1] >= min(cut)), clips[-1])
        raise DatasetError(
            f"{file} is cut short: of its {len(stream.index_entries)} pictures the last {len(cut)} "
            f"are missing, first those of {lost.what}. Copy it again."
        )


def _indexed_times(stream: VideoStream) -> np.ndarray:
    """When pictures are shown (s), rising, where they are evenly apart."""
    entries = [e.timestamp for e in stream.index_entries if not e.is_discard]
    times = np.sort(np.array(entries, float))
    if len(times) and stream.start_time is not None:
        times += stream.start_time - times[0]
    return times * float(stream.time_base or 1)


def _nearest(times: np.ndarray, clip: VideoClip) -> np.ndarray:
    """How far from each step's time the nearest picture is (s) [T]."""
    if not len(times):
        return np.full(len(clip.times), np.inf)
    after = np.searchsorted(times, clip.times).clip(1, len(times) - 1) if len(times) > 1 else 0
    before = np.maximum(after - 1, 0)
    return np.minimum(np.abs(times[after] - clip.times), np.abs(times[before] - clip.times))


def _fit(times: np.ndarray, clips: Sequence[VideoClip]) -> bool:
    return all((_nearest(times, clip) <= clip.tolerance).all() for clip in clips)


def _check_times(times: np.ndarray, clips: Sequence[VideoClip]) -> None:
    """Refuses times of steps at which there is no picture."""
    for clip in clips:
        off = _nearest(times, clip)
        if (off > clip.tolerance).any():
            step = int(np.argmax(off > clip.tolerance))
            shown = f"{len(times)} pictures"
            shown += f" from {times[0]:.4f} to {times[-1]:.4f} s" if len(times) else ""
            raise DatasetError(
                f"{clip.about}: no picture for step {step} at {clip.times[step]:.4f} s; the "
                f"nearest is {off[step]:.4f} s away, {clip.tolerance:.4f} s at most were expected. "
                f"The video has {shown}. Another fps, or a video of another length?"
            )
