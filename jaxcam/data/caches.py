"""A cache of pictures on disk: the array, which of its pictures are drawn, and a checksum of each.

Files of one cache differ in their ending: `.npy` is complete; until then it is `.part`, beside
`.drawn` with a byte for each picture. `.sums` has a CRC-32 of each picture. Version 0.1.0 made
none: its caches get theirs once, and blank pictures, which nobody draws, are taken for damage then.
"""

import logging
import os
import shutil
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from jaxcam.errors import DatasetError
from jaxcam.files.paths import read_bytes, regular
from jaxcam.files.whole import whole

PICTURES_AT_ONCE = 512
"""Pictures that are drawn, kept and verified together."""

_log = logging.getLogger(__name__)


def is_black(picture: np.ndarray) -> bool:
    """Whether a picture [H, W, 3] is all black: a fault of its renderer.

    Of another colour it may be: a camera may stand so near to the robot that it sees nothing else.
    """
    return not picture.any()


class Cache:
    """The pictures of a dataset that are on disk.

    Args:
        path: Of the complete cache; an unfinished one lies beside it.
        shape: Of the array [pictures, H, W, 3].

    Raises:
        DatasetError: The complete file is not what was written.
    """

    def __init__(self, path: Path, shape: tuple[int, ...]) -> None:
        self.path, self._shape, self._size = path, shape, int(np.prod(shape[1:]))
        self.file = path if path.exists() else path.with_suffix(".part")
        self._flags, self._sums = path.with_suffix(".drawn"), path.with_suffix(".sums")
        self._old = not self._sums.exists()
        """Whether it is of version 0.1.0, without checksums."""
        self.sums = _read(self._sums, np.dtype("<u4"), shape[0])
        """CRC-32 of each picture [pictures]."""
        self.drawn = _read(self._flags, np.dtype("u1"), shape[0]) == 1
        """Which pictures are drawn, bool [pictures]; the others are black."""
        self.rgb: np.ndarray | None = None
        """The pictures, through a memory map; None where there is no file yet."""
        try:
            self.rgb = self._mapped()
        except DatasetError as error:
            if self.complete:
                raise
            _log.warning("%s It is drawn anew.", error)
        if self.complete:
            self.drawn[:] = True
        elif self.rgb is None:
            self.drawn[:] = False

    @property
    def complete(self) -> bool:
        """Whether all pictures were drawn."""
        return self.file == self.path

    @property
    def has_sums(self) -> bool:
        """Whether there are checksums; a cache of version 0.1.0 has none until it is used."""
        return not self._old

    def damaged(self, wanted: np.ndarray | None = None) -> np.ndarray:
        """Which of the drawn pictures are not what was drawn, bool [pictures].

        Args:
            wanted: Those that are looked at, bool [pictures]; all when None.
        """
        looked = self.drawn if wanted is None else self.drawn & wanted
        rows, damaged = np.flatnonzero(looked), np.zeros(len(self.drawn), bool)
        if self.rgb is not None and len(rows):
            damaged[rows] = _sums(self.rgb, rows) != self.sums[rows]
        return damaged

    def adopt(self) -> None:
        """Gives a cache of version 0.1.0 its checksums; blank pictures are left without."""
        if self.has_sums or self.rgb is None or not self.drawn.any():
            return
        rows = np.flatnonzero(self.drawn)
        self.sums[rows] = _sums(self.rgb, rows)
        for row in rows:
            if is_black(self.rgb[row]):
                self.sums[row] ^= 1  # which no checksum of it is
        self._old = False
        try:
            _write(self._sums, self.sums)
            _log.debug("%s: made the checksums of %d pictures.", self._sums, len(rows))
        except OSError as error:  # of a folder that is only read
            _log.debug("%s: no checksums are kept (%s).", self._sums, error.strerror)

    def begin(self, damaged: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """Makes sure that there is space for what is to be drawn, and files to put it in.

        Args:
            damaged: Pictures that are to be drawn again, bool [pictures].
            wanted: Pictures that are to be there, bool [pictures].

        Returns:
            Numbers of the pictures to be drawn, ascending.

        Raises:
            DatasetError: The disk has too little.
        """
        if damaged.any():
            _log.warning(
                "%s: %d of %d pictures are not what was drawn, the first is number %d. They are "
                "drawn again.", self.file, damaged.sum(), self.drawn.sum(), damaged.argmax(),
            )  # fmt: skip
        self.drawn &= ~damaged
        missing = np.flatnonzero(wanted & ~self.drawn)
        if not len(missing):
            return missing
        need = 0 if self.complete else len(missing) * self._size
        free = shutil.disk_usage(self.path.parent).free
        if free < need * 1.05:
            raise DatasetError(
                f"{self.path.parent}: the pictures need {need / 1e9:.2g} GB, but {free / 1e9:.2g} "
                "GB are free. Choose another --data-dir or a smaller --resolution."
            )
        try:
            if self.rgb is None:
                np.lib.format.open_memmap(self.file, "w+", np.uint8, self._shape)
            _write(self._sums, self.sums)
            if not self.complete:
                _write(self._flags, self.drawn.astype("u1"))
        except OSError as error:
            raise self._no_room(error) from error
        return missing

    def write(self, rows: np.ndarray, pictures: np.ndarray) -> None:
        """Writes pictures of ascending numbers.

        Raises:
            DatasetError: The disk is full.
        """
        # Not through a map: where the disk is full that kills the process, this raises.
        try:
            offset = self.file.stat().st_size - len(self.drawn) * self._size
            with open(self.file, "r+b") as file:
                for run in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(rows) > 1) + 1):
                    file.seek(offset + int(rows[run[0]]) * self._size)
                    file.write(np.ascontiguousarray(pictures[run]).data)
            self.sums[rows] = _sums(pictures, np.arange(len(rows)))
            _write_part(self._sums, self.sums, rows)
            self.drawn[rows] = True
            if not self.complete:
                _write_part(self._flags, self.drawn.astype("u1"), rows)
        except OSError as error:
            raise self._no_room(error) from error

    def finish(self) -> None:
        """Gives a cache that has become complete its name, and maps what is there."""
        if not self.complete and self.drawn.all():
            os.replace(self.file, self.path)
            self.file = self.path
            self._flags.unlink()
        self.rgb = self._mapped()

    def _mapped(self) -> np.ndarray | None:
        if not self.file.exists():
            return None
        try:
            rgb = np.load(regular(self.file), mmap_mode="r")
            content = f"{rgb.dtype} {list(rgb.shape)}"
        except (OSError, ValueError, EOFError) as error:
            size = self.file.stat().st_size
            rgb, content = None, f"{size} bytes that cannot be read ({error})"
        if rgb is None or rgb.shape != self._shape or rgb.dtype != np.uint8:
            raise DatasetError(
                f"{self.file}: the pictures should be uint8 {list(self._shape)}, but are "
                f"{content}. Delete the file; they are drawn anew."
            )
        return rgb

    def _no_room(self, error: OSError) -> DatasetError:
        return DatasetError(
            f"{self.file}: {error.strerror}. What is rendered is kept; make room and repeat."
        )


def _sums(pictures: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """CRC-32 of some pictures; on all cores, since the disk is faster than one."""

    def of(group: np.ndarray) -> list[int]:
        return [zlib.crc32(np.ascontiguousarray(pictures[row]).data) for row in group]

    groups = np.split(rows, range(PICTURES_AT_ONCE, len(rows), PICTURES_AT_ONCE))
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return np.array([x for group in pool.map(of, groups) for x in group], "<u4")


def _read(path: Path, dtype: np.dtype, count: int) -> np.ndarray:
    """Numbers of a file; 0 where it has none, and for all if it has too many."""
    numbers = np.zeros(count, dtype)
    if path.exists() and path.stat().st_size <= numbers.nbytes:
        content = read_bytes(path, numbers.nbytes)
        read = np.frombuffer(content, dtype, len(content) // numbers.itemsize)
        numbers[: len(read)] = read
    return numbers


def _write(path: Path, numbers: np.ndarray) -> None:
    with whole(path) as part, open(part, "wb") as file:
        file.write(numbers.tobytes())
        file.flush()
        os.fsync(file.fileno())


def _write_part(path: Path, numbers: np.ndarray, rows: np.ndarray) -> None:
    """Writes the numbers from the first to the last of some ascending rows in place."""
    with open(path, "r+b") as file:
        file.seek(int(rows[0]) * numbers.itemsize)
        file.write(numbers[rows[0] : rows[-1] + 1].tobytes())
