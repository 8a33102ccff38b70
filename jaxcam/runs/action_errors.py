"""The errors of a run's actions on recorded episodes, on disk."""

from pathlib import Path

from jaxcam.errors import DatasetError
from jaxcam.files.jsonl import read_jsonl
from jaxcam.results.actions import ActionErrors


def errors_file(run: Path) -> Path:
    """The file of a run's errors, one row for each checkpoint, group and error of poses."""
    return run / "eval" / "actions.jsonl"


def read_errors(run: Path) -> list[ActionErrors]:
    """The rows of a run in the order they were written; none if there are none.

    Raises:
        DatasetError: A line is damaged, or is no such row.
    """
    rows, file = [], errors_file(run)
    for number, line in enumerate(read_jsonl(file), start=1):
        try:
            rows.append(ActionErrors.from_json(line))
        except DatasetError as error:
            raise DatasetError(f"{file}, line {number}: {error}") from error
    return rows
