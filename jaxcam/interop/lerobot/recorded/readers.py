"""Files of pictures that are read forwards, and left open where an episode ended.

Episodes lie one behind the other in a file. Whoever reads them in their order reads on where the
last one ended, so that nothing is decoded twice; in any other order, a file is gone through from a
place before the episode.
"""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Generic, Protocol, TypeVar

import numpy as np


class Clip(Protocol):
    """What one camera saw of one episode, in a file."""

    @property
    def view(self) -> str:
        """The camera's name."""
        ...

    @property
    def file(self) -> Path:
        """Where the pictures are."""
        ...


C = TypeVar("C", bound=Clip)
Anywhere = TypeVar("Anywhere", bound=Clip, contravariant=True)


class Reader(Protocol[Anywhere]):
    """An open file of pictures."""

    @property
    def file(self) -> Path:
        """The file."""
        ...

    def pictures(self, clip: Anywhere) -> Iterator[np.ndarray]:
        """An episode's pictures, uint8 [H, W, 3]."""
        ...

    def close(self) -> None:
        """Lets the file go."""
        ...


class Readers(Generic[C]):
    """The files of one kind that are open: at most one a view, between two episodes.

    Args:
        kind: Opens a clip's file.
    """

    def __init__(self, kind: Callable[[C], Reader[C]]) -> None:
        self._kind = kind
        self._left: dict[str, Reader[C]] = {}

    def decode(self, clip: C) -> Iterator[np.ndarray]:
        """An episode's pictures, uint8 [H, W, 3], in order of time."""
        with self._reader(clip) as reader:
            yield from reader.pictures(clip)

    @contextlib.contextmanager
    def _reader(self, clip: C) -> Iterator[Reader[C]]:
        """The file, alone for whoever reads it; one that was not read to the end is closed."""
        reader = self._left.pop(clip.view, None)
        if reader is not None and reader.file != clip.file:
            reader.close()
            reader = None
        reader = reader or self._kind(clip)
        try:
            yield reader
        except BaseException:
            reader.close()
            raise
        if before := self._left.pop(clip.view, None):
            before.close()
        self._left[clip.view] = reader
