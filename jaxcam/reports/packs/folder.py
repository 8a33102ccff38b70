"""A results folder: `rows.jsonl`, a line a rollout, and `runs.json` beside it."""

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxcam.config.names import EvaluationSplit, names_of
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.files.jsonl import line_of, read_jsonl
from jaxcam.files.locks import exclusive
from jaxcam.files.whole import write_together
from jaxcam.reports.arms import Run
from jaxcam.reports.packs.records import NAMED, read_records
from jaxcam.results.rows import CONDITIONS, USUAL_WAY, Row
from jaxcam.results.stats import latest_rows
from jaxcam.runs.foreign import has_foreign
from jaxcam.runs.identity import Settings
from jaxcam.runs.rollouts import of_one_run

ROWS, RUNS = "rows.jsonl", "runs.json"
_KEPT = ("step", "split", "pair", "pair_sha", "weights_sha", "success", "status", "cause", "steps",
         "azimuth_deg", "elevation_deg", "distance", "renderer", "width", "fovy_deg")  # fmt: skip


def write_results(folder: Path, runs: Sequence[Run]) -> None:
    """Write `rows.jsonl` and `runs.json`, from which `read_runs` reads the same runs again.

    Args:
        folder: Where they go; what is there is replaced.
        runs: The runs; those without rows are left out.

    Raises:
        ConfigError: The folder has rows that are not among these.
    """
    check_replaces(folder, runs)
    folder.mkdir(parents=True, exist_ok=True)
    with exclusive(folder / ROWS):  # a row's number is that of its run in the other file
        write_together({folder / name: text for name, text in results_texts(runs).items()})


def results_texts(runs: Sequence[Run]) -> dict[str, str]:
    """The two files of a results folder, by their names.

    Args:
        runs: The runs; those without rows are left out.
    """
    runs = [run for run in runs if run.rows]
    records = [
        {"run": i, "name": run.name, "seed": run.seed, "seconds": round(run.seconds), "settings":
         run.settings} for i, run in enumerate(runs)
    ]  # fmt: skip
    rows = ({"run": i, **_brief(row)} for i, run in enumerate(runs) for row in run.rows)
    return {ROWS: "".join(map(line_of, rows)), RUNS: json.dumps(records, indent=1) + "\n"}


def check_replaces(folder: Path, runs: Sequence[Run], flag: str = "--out") -> None:
    """Refuses a folder whose rows would be lost if a report of these runs were written there.

    Args:
        folder: Where a report is to go.
        runs: What it is of.
        flag: That named the folder.

    Raises:
        ConfigError: It is a run's folder, or has rows that are not among these runs'.
    """
    if (folder / "config.json").exists() or has_foreign(folder):
        raise ConfigError(f"{folder} is the folder of a run. Choose another {flag}.")
    if not (folder / "rows.jsonl").exists():
        return
    if not (folder / "runs.json").exists():
        raise ConfigError(
            f"{folder / 'rows.jsonl'} was not written by this command, which would replace it. "
            f"Choose another {flag}."
        )
    # Settings that are newer than the report are not in it: the name and the seed do, too.
    new: Counter[Any] = Counter(
        (key, row.split)
        for run in runs
        for row in run.rows
        for key in (run_key(run), (run.name, run.seed))
    )
    lost = [
        run.name
        for split in names_of(EvaluationSplit)
        for run in read_results(folder, split)
        if max(new[run_key(run), split], new[(run.name, run.seed), split]) < len(run.rows)
    ]
    if lost:
        raise ConfigError(
            f"{folder} has rollouts of {len(lost)} runs that would be lost, such as {lost[0]}: "
            f"they are not among those given. Give {folder} too, or choose another {flag}."
        )


def run_key(run: Run) -> str:
    """What a run is known by: its settings and its seed.

    Args:
        run: The run.
    """
    return json.dumps([run.settings, run.seed], sort_keys=True)


def read_results(folder: Path, split: str | None) -> list[Run]:
    """The runs of a folder that `write_results` made: its rows have the number of their run.

    Args:
        folder: Of the results.
        split: Which pairs, such as "test"; all when None.

    Raises:
        DatasetError: One of its files is damaged.
    """
    lines: dict[int, list[tuple[str, Settings]]] = {}
    for number, line in enumerate(read_jsonl(folder / ROWS), start=1):
        where = f"{folder / 'rows.jsonl'}, line {number}"
        if not isinstance(line, dict) or not isinstance(line.get("run"), int):
            raise DatasetError(f"{where}: expected a rollout with the number of its run.")
        lines.setdefault(line["run"], []).append((where, line))
    records = read_records(folder / RUNS)
    if strange := lines.keys() - {record.run for record in records}:
        raise DatasetError(
            f"{folder / 'rows.jsonl'} has rows of run {min(strange)}, of which runs.json says "
            "nothing: the two files are not of one report."
        )
    runs = []
    for record in records:
        shared = {name: record.settings.get(name) for name in NAMED}
        shared |= {"run": record.name, "seed": record.seed}
        # Where a run was evaluated in several ways, the settings list them all.
        shared |= {k: v for k, v in record.settings.items()
                   if k in CONDITIONS or (k in USUAL_WAY and not isinstance(v, list))}  # fmt: skip
        given = lines.get(record.run, [])
        rows = of_one_run((where, Row.from_json(line | shared, where)) for where, line in given)
        rows = [row for row in latest_rows(rows) if split is None or row.split == split]
        runs.append(
            Run(record.name, None, record.settings, record.seed, rows, record.seconds, str(folder))
        )
    return runs


def _brief(row: Row) -> Settings:
    brief = row.to_json(_KEPT)
    return {k: round(v, 3) if isinstance(v, float) else v for k, v in brief.items()}
