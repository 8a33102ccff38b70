"""Pictures in tables: a PNG or JPEG a row, as LeRobot keeps images that are no video."""

import contextlib
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from jaxcam.errors import DatasetError
from jaxcam.interop.lerobot.arrow import pa
from jaxcam.interop.lerobot.recorded.tables import one_line, open_table

_BATCH = 16
"""Rows that are read at a time."""


@dataclass(frozen=True)
class ImageClip:
    """What one camera saw of one episode, in a table."""

    view: str
    """The camera's name."""
    file: Path
    column: str
    first: int
    """Row of its first picture."""
    length: int
    """Pictures."""
    episode: str
    """Its name, for messages."""

    @property
    def about(self) -> str:
        """For messages."""
        return f"{self.file}, {self.episode} of view '{self.view}'"


def check_images(clip: ImageClip) -> tuple[int, int]:
    """Refuses a column of a table that has no pictures.

    Args:
        clip: An episode in it.

    Returns:
        Height and width of its first picture.

    Raises:
        DatasetError: The column has none, or the picture cannot be decoded.
    """
    reader = ImageReader(clip)
    with contextlib.closing(reader), contextlib.closing(reader.pictures(clip)) as pictures:
        height, width, _ = next(pictures).shape
    return height, width


def identity(file: Path) -> bytes:
    """A hash of all of a table: pictures are all over it, and nothing in it is a digest of them.

    Args:
        file: The table.
    """
    with open(file, "rb") as data:
        return hashlib.file_digest(data, "sha256").digest()


class ImageReader:
    """An open table whose pictures are read forwards.

    Args:
        clip: An episode in it.
    """

    def __init__(self, clip: ImageClip) -> None:
        self.file = clip.file
        self._table = open_table(clip.file)
        self._column = ""
        self._rows: Iterator[bytes | None] = iter(())
        self._next = -1

    def close(self) -> None:
        """Lets the file go."""
        self._table.close()

    def pictures(self, clip: ImageClip) -> Iterator[np.ndarray]:
        """An episode's pictures, uint8 [H, W, 3].

        Raises:
            DatasetError: They are missing or cannot be decoded.
        """
        if (self._column, self._next) != (clip.column, clip.first):
            self._rows, self._next = self._rows_from(clip), clip.first
            self._column = clip.column
        for step in range(clip.length):
            yield _decode(self._take(clip), f"{clip.about}: the picture of step {step}")

    def _take(self, clip: ImageClip) -> bytes | None:
        try:
            content = next(self._rows, None)
        except (OSError, pa.ArrowException) as error:
            raise DatasetError(f"{clip.about}: the table is damaged: {one_line(error)}.") from error
        self._next += 1
        return content

    def _rows_from(self, clip: ImageClip) -> Iterator[bytes | None]:
        """The column's contents from an episode's first row on."""
        field = self._table.schema_arrow.field(clip.column)
        name = clip.column
        if pa.types.is_struct(field.type) and field.type.get_field_index("bytes") >= 0:
            name = f"{clip.column}.bytes"
        elif not (pa.types.is_binary(field.type) or pa.types.is_large_binary(field.type)):
            raise DatasetError(
                f"{clip.about}: the column '{clip.column}' has no PNG or JPEG but {field.type}."
            )
        groups, skipped = self._groups(clip.first)
        batches = self._table.iter_batches(_BATCH, groups, [name], use_threads=False)
        for batch in batches:
            column = batch.column(batch.schema.get_field_index(clip.column))
            column = column.field("bytes") if name != clip.column else column
            for i in range(min(skipped, len(column)), len(column)):
                yield column[i].as_py()
            skipped = max(0, skipped - len(column))

    def _groups(self, row: int) -> tuple[list[int], int]:
        """The row groups from the one with a row on, and how many rows of it are before it."""
        about = self._table.metadata
        before = 0
        for group in range(about.num_row_groups):
            size = about.row_group(group).num_rows
            if row < before + size:
                return list(range(group, about.num_row_groups)), row - before
            before += size
        return [], 0


def _decode(content: bytes | None, what: str) -> np.ndarray:
    """A PNG or JPEG as uint8 [H, W, 3]."""
    if not isinstance(content, bytes) or not content:
        raise DatasetError(f"{what} is not in the table. LeRobot puts images there when it saves.")
    try:
        shown = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error as error:
        raise DatasetError(f"{what} cannot be decoded: {error}.") from error
    if shown is None:
        raise DatasetError(f"{what} cannot be decoded: it begins with {content[:8]!r}.")
    return cv2.cvtColor(shown, cv2.COLOR_BGR2RGB)
