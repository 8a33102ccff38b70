"""Files of JSON lines."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxcam.errors import DatasetError


def append_jsonl(path: str | Path, *rows: Mapping[str, Any], fsync: bool = False) -> None:
    """Append rows to a file of JSON lines, in one write.

    A last line that a crash left torn is cut off first.

    Args:
        path: File; made if missing.
        rows: Rows; NumPy and JAX numbers in them become plain ones.
        fsync: Whether to wait until the rows are on the disk.
    """
    data = "".join(line_of(row) for row in rows).encode()
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
    with open(descriptor, "r+b", buffering=0) as file:
        _cut_torn_line(file)
        while data:  # A nearly full disk takes a part, then raises on the next write.
            data = data[file.write(data) :]
        if fsync:
            os.fsync(file.fileno())


def read_jsonl(path: str | Path, *, may_be_torn: bool = True) -> list[dict[str, Any]]:
    """Rows of a file of JSON lines; none if it is missing.

    Args:
        path: File.
        may_be_torn: Whether a last line without its end is one that a crash left, and is left out;
            in a file that was written by others it is a row.

    Raises:
        DatasetError: A line before the last one is damaged or no object, or the file is none.
    """
    path = Path(path)
    if not path.exists():
        return []
    if not path.is_file():
        raise DatasetError(f"{path} is no file.")
    rows = []
    try:
        whole = path.read_bytes()
    except OSError as error:
        raise DatasetError(f"{path} cannot be read: {error.strerror}.") from error
    if may_be_torn:
        whole, _, _ = whole.rpartition(b"\n")
    for number, line in enumerate(whole.splitlines(), start=1):
        try:
            row = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise DatasetError(f"{path}, line {number}, is damaged: {line[:80]!r}.") from error
        if not isinstance(row, dict):
            wanted = "expected names with values"
            raise DatasetError(f"{path}, line {number}: {wanted}, got {line[:80]!r}.")
        rows.append(row)
    return rows


def _cut_torn_line(file: Any) -> None:
    """Cut what follows the last line end, looking back block by block."""
    end = keep = file.seek(0, os.SEEK_END)
    while keep:
        start = max(0, keep - 65536)
        file.seek(start)
        block = file.read(keep - start)
        if (line_end := block.rfind(b"\n")) >= 0:
            keep = start + line_end + 1
            break
        keep = start
    if keep < end:
        file.truncate(keep)


def line_of(row: Mapping[str, Any]) -> str:
    """A row as a line of JSON; NumPy and JAX numbers in it become plain ones."""
    return json.dumps(row, default=lambda x: x.tolist()) + "\n"
