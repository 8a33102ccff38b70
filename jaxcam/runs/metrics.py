"""The metrics of a run as they are read: rows of numbers, each of an update."""

from pathlib import Path

from jaxcam.errors import DatasetError
from jaxcam.files.jsonl import read_jsonl

MetricsRow = dict[str, float]
"""A row: "step", and what was measured there by its name."""

_COUNTS = ("step", "pairs")
_SHARES = ("success_rate", "low", "high")


def read_metrics(run: Path) -> list[MetricsRow]:
    """The rows of a run's `metrics.jsonl` in the order they were written; none if it is missing.

    What was not a finite number when it was measured is written as such, and read so.

    Args:
        run: Folder of the run.

    Raises:
        DatasetError: A line is damaged, or is no row of metrics.
    """
    file = run / "metrics.jsonl"
    rows = read_jsonl(file)
    for number, row in enumerate(rows, start=1):
        if wrong := _wrong(row):
            raise DatasetError(f"{file}, line {number}: {wrong}")
    return rows


def _wrong(row: MetricsRow) -> str:
    """Why a row is none of metrics; empty if it is one."""
    if "step" not in row:
        return "it has no 'step'."
    for name, value in row.items():
        is_share = name in _SHARES
        if not isinstance(value, int | float) or isinstance(value, bool):
            return f"{name!r:.80} is {value!r:.80}, expected a number."
        if name in _COUNTS and not (isinstance(value, int) and 0 <= value < 2**63):
            return f"{name} is {value!r:.80}, expected a whole number, 0 or more."
        if is_share and (value < 0 or value > 1):  # NaN is that of no rollout
            return f"{name} is {value!r:.80}, expected a share."
        if isinstance(value, int) and abs(value) >= 2**63:
            return f"{name!r:.80} is beyond 64 bits."
    if "success_rate" in row and not row.keys() >= {*_SHARES}:
        return "it has a success rate without its interval."
    return ""
