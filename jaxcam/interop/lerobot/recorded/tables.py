"""Parquet tables as NumPy arrays, with words for what is wrong with them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxcam.errors import DatasetError
from jaxcam.interop.lerobot.arrow import pa, parquet

_LISTED = 12
"""Columns that a message lists."""


def open_table(path: Path) -> parquet.ParquetFile:
    """An open file, of which columns are read a piece at a time.

    Raises:
        DatasetError: It is missing or damaged.
    """
    if not path.is_file():
        raise DatasetError(f"{path} is missing. Was the dataset copied or downloaded in part?")
    try:
        # without pre_buffer, a column's pieces are not all held until they are asked for
        file = parquet.ParquetFile(path, pre_buffer=False, buffer_size=2**20)
        _ = file.schema_arrow.names  # which may be no texts
    except (OSError, ValueError, pa.ArrowException) as error:
        raise DatasetError(f"{path} is no whole table: {one_line(error)}.") from error
    return file


def read_table(path: Path, names: Sequence[str] | None = None) -> pa.Table:
    """Columns of a table.

    Args:
        path: Its file.
        names: Of the columns; all when None.

    Raises:
        DatasetError: The file is missing or damaged, or does not have each column once.
    """
    with open_table(path) as file:
        there = file.schema_arrow.names
        if missing := [name for name in names or () if name not in there]:
            raise DatasetError(no_column(path, missing[0], there))
        if doubled := [name for name in names or there if there.count(name) > 1]:
            raise DatasetError(f"{path} has two columns '{doubled[0]}'.")
        try:
            table = file.read(columns=list(names) if names else None)
        except (OSError, pa.ArrowException) as error:
            raise DatasetError(f"{path} is damaged: {one_line(error)}.") from error
    return table.select(names) if names else table


def whole_numbers(table: pa.Table, name: str, path: Path) -> list[int]:
    """A column of whole numbers.

    Raises:
        DatasetError: There is none, or it has others.
    """
    column = _column(table, name, path)
    if not pa.types.is_integer(column.type) or column.null_count:
        raise DatasetError(f"{path}: '{name}' are whole numbers, got {column.type}{_gaps(column)}.")
    return column.to_pylist()


def texts(table: pa.Table, name: str, path: Path) -> list[str]:
    """A column of texts.

    Raises:
        DatasetError: There is none, or it has others.
    """
    column = _column(table, name, path)
    is_text = pa.types.is_string(column.type) or pa.types.is_large_string(column.type)
    if not is_text or column.null_count:
        raise DatasetError(f"{path}: '{name}' are texts, got {column.type}{_gaps(column)}.")
    try:
        return column.to_pylist()
    except UnicodeDecodeError as error:
        raise DatasetError(f"{path}: '{name}' has a text that is not UTF-8.") from error


def rows_of_numbers(table: pa.Table, name: str, path: Path) -> np.ndarray:
    """A column of numbers, or of lists of them, as deep as they are.

    Args:
        table: Of R rows.
        name: Of the column.
        path: The table's file, for messages.

    Returns:
        [R, N] as they are stored.

    Raises:
        DatasetError: There is no such column, rows have different numbers of numbers, or none.
    """
    column = _column(table, name, path)
    pieces = [_flat(chunk, f"{path}: '{name}'") for chunk in column.chunks if len(chunk)]
    if len({piece.shape[1] for piece in pieces}) > 1:
        raise DatasetError(f"{path}: '{name}' has rows of different lengths.")
    return np.concatenate(pieces) if pieces else np.zeros((0, 0))


def one_line(error: Exception) -> str:
    """What an error of Arrow's says, without its line ends."""
    return " ".join(str(error).split()).rstrip(".")


def no_column(path: Path, name: str, there: Sequence[str]) -> str:
    """The message for a column that a table lacks; tables of episodes have hundreds."""
    others = f" and {len(there) - _LISTED} others" if len(there) > _LISTED else ""
    return f"{path} has no column '{name}'. It has {', '.join(there[:_LISTED])}{others}."


def _column(table: pa.Table, name: str, path: Path) -> pa.ChunkedArray:
    if name not in table.column_names:
        raise DatasetError(no_column(path, name, table.column_names))
    return table.column(name)


def _flat(array: pa.Array, what: str) -> np.ndarray:
    """Rows of numbers, however their lists are nested."""
    rows = len(array)
    while True:
        if isinstance(array.type, pa.BaseExtensionType):
            array = array.storage
        if array.null_count:
            raise DatasetError(f"{what} has {array.null_count} empty places.")
        if not _is_list(array.type):
            break
        parts = array.flatten()
        if not pa.types.is_fixed_size_list(array.type):
            lengths = array.value_lengths().to_numpy()
            if lengths.min() != lengths.max() or not lengths.max():
                raise DatasetError(
                    f"{what} has rows of {lengths.min()} to {lengths.max()} numbers, not of one "
                    "size."
                )
        array = parts
    is_number = pa.types.is_integer(array.type) or pa.types.is_floating(array.type)
    if not is_number and not pa.types.is_boolean(array.type):
        raise DatasetError(f"{what} are no numbers but {array.type}.")
    return array.to_numpy(zero_copy_only=False).reshape(rows, -1)


def _is_list(kind: pa.DataType) -> bool:
    tests = (pa.types.is_list, pa.types.is_large_list, pa.types.is_fixed_size_list)
    return any(test(kind) for test in tests)


def _gaps(column: pa.ChunkedArray) -> str:
    return f" with {column.null_count} empty places" if column.null_count else ""
