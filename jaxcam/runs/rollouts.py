"""The rows of rollouts on disk: where a run has them, and how they are read."""

from pathlib import Path

from jaxcam.files.jsonl import read_jsonl
from jaxcam.results.rows import Row


def rows_file(run: Path) -> Path:
    """The file of a run's rows, one a rollout."""
    return run / "eval" / "rows.jsonl"


def read_rows(file: Path) -> list[Row]:
    """The rows of a file in the order they were written; none if it is missing.

    Raises:
        DatasetError: A line is damaged, or is no row.
    """
    lines = read_jsonl(file)
    return [Row.from_json(x, f"{file}, line {number}") for number, x in enumerate(lines, start=1)]
