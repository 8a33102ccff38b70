"""What is kept of a rollout on a robot, and how it is as_rows.

A row of ours (`jaxcam.results.rows.Row`) is one rollout on a numbered pair that everybody can have
again; it has a digest, an engine and one of two outcomes. A rollout on a robot has three outcomes,
a comment, and a start that nobody else can have. So it is a record of its own, kept under letters
while the trial goes on. For the statistics, which are the same, `as_rows` makes rows of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from jaxcam.config.fields import as_record
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.files.jsonl import append_jsonl, read_jsonl
from jaxcam.results.rows import Row
from jaxcam.robot.trials.order import Rollout
from jaxcam.robot.trials.sheet import Sheet

Outcome = Literal["success", "half", "failure", "redo"]
"""How a rollout ended; `redo` does not count, and is run again."""
Threshold = Literal["whole", "half"]
"""What counts as a success: a whole one only, or half a one as well."""


@dataclass(frozen=True, kw_only=True)
class TrialRow:
    """A rollout that was rated."""

    number: int
    """In the order of the trial, from 1."""
    policy: str
    """Its letter."""
    placement: str
    """Where the cameras stood; empty if they never move."""
    cameras: tuple[str, ...]
    """Those that were used."""
    start: int
    """From 0."""
    outcome: Outcome
    comment: str = ""
    """What the operator said."""
    seconds: float = 0.0
    """It took."""
    time: str = ""
    """When it was rated."""
    fault: str = ""
    """What ended it, if it was neither the operator nor the time."""
    lateness: str = ""
    """How well actions were there when they were needed."""
    weights_sha: str = ""
    """Digest of the weights that acted, if the server says it."""
    calibration: dict[str, Any] | None = None
    """What the policy was told of its cameras: by the camera, K and pose."""


def read_trial_rows(path: Path, planned: Sequence[Rollout]) -> list[TrialRow]:
    """The rows of a trial in the order in which they were written.

    Args:
        path: Of the file.
        planned: The trial's rollouts.

    Raises:
        DatasetError: A line is damaged, or is not of this trial.
    """
    rows = []
    for line, content in enumerate(read_jsonl(path), start=1):
        where = f"{path}, line {line}"
        try:
            row = as_record(TrialRow, content, where)
        except ConfigError as error:
            raise DatasetError(f"{error} Put the file back as it was written.") from error
        if not 1 <= row.number <= len(planned):
            raise DatasetError(f"{where}: rollout {row.number}; the sheet has 1 to {len(planned)}.")
        _check_is(row, planned[row.number - 1], where)
        rows.append(row)
    return rows


def _check_is(row: TrialRow, rollout: Rollout, where: str) -> None:
    """Refuses a row that is of another rollout than the one of its number."""
    condition = rollout.condition
    asked = (rollout.letter, condition.placement, condition.cameras, condition.start)
    if (row.policy, row.placement, row.cameras, row.start) != asked:
        raise DatasetError(
            f"{where}: rollout {row.number} is policy {rollout.letter} at placement "
            f"{condition.placement!r} with {', '.join(condition.cameras) or 'no cameras'} from "
            f"start {condition.start + 1}, and the row is of something else. Likely cause: rows of "
            "another sheet, or of another version of jaxcam. Move them away, or put the sheet back."
        )


def append_row(path: Path, row: TrialRow) -> None:
    """Add a row to the file, and wait until it is on the disk."""
    append_jsonl(path, {k: v for k, v in asdict(row).items() if v not in ("", None)} | {
        "placement": row.placement
    }, fsync=True)  # fmt: skip


def done(rows: Sequence[TrialRow]) -> dict[int, TrialRow]:
    """The rows that count, by the number of their rollout: the last of each that is no `redo`."""
    latest = {row.number: row for row in rows}
    return {number: row for number, row in latest.items() if row.outcome != "redo"}


def as_rows(
    sheet: Sheet,
    planned: Sequence[Rollout],
    rated: Mapping[int, TrialRow],
    policy: int,
    threshold: Threshold,
) -> list[Row]:
    """The rollouts of a policy as the statistics take them.

    Rollouts that share a placement of the cameras are one cluster (a row's `pair`), since the same
    poses are in all of them; where cameras never move, those that share a start.

    Args:
        sheet: Of the trial.
        planned: Its rollouts.
        rated: From `done`.
        policy: Number of the policy in the sheet.
        threshold: What counts as success.
    """
    good = ("success",) if threshold == "whole" else ("success", "half")
    places = sheet.placements
    return [
        Row(
            task=sheet.task,
            run=sheet.policies[policy].name,
            pair=places.index(c.placement) if len(places) > 1 else c.start,
            success=rated[rollout.number].outcome in good,
            status="ok",
            engine="robot",
        )
        for rollout in planned
        for c in [rollout.condition]
        if rollout.policy == policy and rollout.number in rated
    ]


def shared(planned: Sequence[Rollout], rated: Mapping[int, TrialRow]) -> dict[int, TrialRow]:
    """The rows of conditions that every policy has met, which alone can be compared."""
    missing = {r.condition.number for r in planned if r.number not in rated}
    return {r.number: rated[r.number] for r in planned if r.condition.number not in missing}
