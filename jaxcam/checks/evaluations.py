"""Whether the evaluations of a run are its own and whole: one outcome for each of their pairs."""

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from jaxcam.checks.findings import Finding, bad, good, note
from jaxcam.console.words import some
from jaxcam.errors import JaxcamError
from jaxcam.results.rows import CONDITIONS, Row
from jaxcam.results.stats import latest_rows
from jaxcam.runs.rollouts import read_run_rows


def check_evaluations(folder: Path, pairs: int) -> Iterator[Finding]:
    """Whether the rows are the run's, and each evaluated checkpoint has an outcome for each pair.

    Args:
        folder: Of the run.
        pairs: Pairs that the run's settings ask for; an evaluation may have more.
    """
    try:
        rows = read_run_rows(folder)
    except JaxcamError as error:
        fix = "Cut the file before that line, or move the folder eval away and evaluate anew."
        yield bad("evaluation", got=str(error), fix=fix)
        return
    if not rows:
        yield note("evaluation", got="none yet", fix=f"python -m jaxcam.evaluate {folder}")
        return
    yield from _several_outcomes(rows)
    cells: dict[tuple[str, int, str], list[Row]] = {}
    for row in latest_rows(rows):
        cells.setdefault((row.split, row.step, _flags(row)), []).append(row)
    most: dict[str, int] = {}
    for (split, *_), cell in cells.items():
        most[split] = max(most.get(split, 0), len(cell))
    for (split, step, flags), cell in sorted(cells.items(), key=lambda item: item[0]):
        asked = max(min(pairs, most[split]), 1 + max(row.pair for row in cell))
        again = (
            f"python -m jaxcam.evaluate {folder} --split {split} --step {step} --pairs {asked}"
            f"{flags}"
        )
        yield _outcomes(cell, asked, f"{split}, step {step}{flags}", again)


def _flags(row: Row) -> str:
    """The flags that ask for a row's conditions, which are none where all was as usual."""
    said = zip(CONDITIONS, row.conditions, strict=True)
    names = ((name.removeprefix("eval_").replace("_", "-"), value) for name, value in said)
    return "".join(f" --{name} {value}" for name, value in names if value is not None)


def _several_outcomes(rows: Sequence[Row]) -> Iterator[Finding]:
    """A finding where rollouts have more outcomes than one."""
    count = Counter(_rollout(row) for row in rows if row.finished)
    twice = [rollout for rollout, outcomes in count.items() if outcomes > 1]
    if twice:
        yield bad(
            "evaluation",
            got=f"{len(twice)} rollouts have several outcomes",
            expected="one",
            where=f"pair {some([rollout[-1] for rollout in twice])}",
            fix="Two processes wrote, or files were joined: keep the first of each.",
        )


def _rollout(row: Row) -> tuple[Any, ...]:
    """The fields that identify a row's rollout within its run."""
    return row.split, row.step, *row.way, *row.conditions, row.pair


def _outcomes(rows: Sequence[Row], asked: int, where: str, again: str) -> Finding:
    """Whether one evaluation's rows are all that was asked for; `again` runs what is missing."""
    done = sum(row.finished for row in rows)
    got = f"{done} of {asked} pairs have an outcome"
    if broken := sum(row.status == "policy" for row in rows):
        got += f"; in {broken} the policy gave no actions, which are failures"
    if done == asked:
        return good("evaluation", got=got, where=where)
    if failed := len(rows) - done:
        got += f"; {failed} ended in an error of the simulator"
    fix = f"Run what is missing: {again}"
    return note("evaluation", got=got, expected=f"{asked}", where=where, fix=fix)
