"""The rollouts of many runs, with the settings they were made with: what a report is made from.

A *run* is one seed; an *arm* is all runs of the same settings. Both are read from run folders, or
from a results folder (`rows.jsonl` and `runs.json`), which `write_results` makes of them.
"""

import functools
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jaxcam.errors import ConfigError, DatasetError
from jaxcam.files.jsonl import line_of, read_jsonl
from jaxcam.files.locks import exclusive
from jaxcam.files.paths import absolute
from jaxcam.files.whole import write_together
from jaxcam.reports.records import NAMED, NOT_RECORDED, read_records
from jaxcam.results.differences import PairedDifference, paired_difference
from jaxcam.results.protocol import Protocol, counted, lacks, protocol_of
from jaxcam.results.rows import USUAL_WAY, Row
from jaxcam.results.stats import Estimate, latest_rows, success_rate
from jaxcam.runs.foreign import has_foreign, read_foreign
from jaxcam.runs.identity import Settings, changes, identity, plain, read_config
from jaxcam.runs.manifests import record_of_weights, sides
from jaxcam.runs.metrics import read_metrics
from jaxcam.runs.rollouts import of_one_run, read_rows, read_run_rows

_KEPT = ("step", "split", "pair", "pair_sha", "weights_sha", "success", "status", "cause", "steps",
         "azimuth_deg", "elevation_deg", "distance", "renderer", "width")  # fmt: skip


@dataclass(frozen=True)
class Run:
    """One seed of one setting.

    Attributes:
        name: Its folder's name.
        folder: Where its videos are; None if only its rows are known.
        settings: What makes it comparable to others; seed and file names are not among them.
        seed: Its seed.
        rows: Its evaluation rows, one a rollout.
        seconds: Wall time of its training; 0 if unknown.
    """

    name: str
    folder: Path | None
    settings: Settings
    seed: int | None
    rows: list[Row]
    seconds: float = 0.0

    @property
    def protocol(self) -> Protocol:
        """What its evaluation is measured against."""
        return protocol_of(self.settings.get("policy", ""))

    @property
    def counted(self) -> list[Row]:
        """The rows its success rate is taken over."""
        return counted(self.rows, self.protocol)


@dataclass(frozen=True, eq=False)
class Arm:
    """All runs of the same settings: a cell of a table, a bar of a figure."""

    runs: tuple[Run, ...]

    @property
    def settings(self) -> Settings:
        """What its runs share."""
        return self.runs[0].settings

    @functools.cached_property
    def rows(self) -> list[Row]:
        """The counted rows of all its runs."""
        return [row for run in self.runs for row in run.counted]

    @functools.cached_property
    def estimate(self) -> Estimate:
        """Its success with interval."""
        return success_rate(self.rows)

    def against(self, other: "Arm") -> PairedDifference:
        """Its success minus another arm's on the pairs that both have; computed once."""
        if other not in self._differences:
            self._differences[other] = paired_difference(self.rows, other.rows)
        return self._differences[other]

    @functools.cached_property
    def _differences(self) -> dict["Arm", PairedDifference]:
        return {}

    @functools.cached_property
    def lacks(self) -> list[str]:
        """What it lacks of the protocol."""
        runs = [run.counted for run in self.runs]
        return lacks(runs, self.runs[0].protocol, self.settings.get("steps"))

    @functools.cached_property
    def changes(self) -> Settings:
        """The settings in which it is not what its policy's preset and its task give."""
        if self.settings.get("preset") is None:
            return {}
        return changes(self.settings)

    def count(self) -> str:
        """Rollouts, and how many the protocol asks for where it lacks any."""
        asked = self.runs[0].protocol.rollouts
        n = self.estimate.n
        if not self.lacks:
            return f"{n}"
        return f"{n} of {asked}" if n < asked else f"{n}, {', '.join(self.lacks)}"

    def label(self, *without: str) -> str:
        """Preset and changes in words.

        Args:
            *without: Settings that are said elsewhere.
        """
        if self.settings.get("preset") is None:
            return "settings not recorded"
        changes = (f"{k} {plain(v)}" for k, v in self.changes.items() if k not in without)
        return ", ".join([f"{self.settings['preset']} preset", *changes])


def read_runs(paths: Iterable[str | Path], split: str = "test") -> list[Run]:
    """All runs in and below folders; each run once, however often it is met.

    Args:
        paths: Run folders, results folders, or folders that hold such.
        split: Which pairs: "test" or "validation".

    Raises:
        ConfigError: A folder has no run, two runs of the same settings and seed disagree, or a pair
            of one run is not the pair of that number in another.
    """
    runs: dict[str, Run] = {}
    for path in map(absolute, paths):
        folders = list(_find(path, set()))
        if not folders:
            raise ConfigError(
                f"No run in {path}: neither it nor a folder below it has a config.json or a "
                "rows.jsonl."
            )
        for folder in folders:
            for run in _read(folder, split):
                key = _key(run)
                runs[key] = _merge(runs[key], run) if key in runs else run
    _check_pairs(runs.values())
    return list(runs.values())


def group(runs: Iterable[Run]) -> list[Arm]:
    """Runs of the same settings as one arm each, in order of first appearance."""
    arms: dict[str, list[Run]] = {}
    for run in runs:
        arms.setdefault(json.dumps(run.settings, sort_keys=True), []).append(run)
    return [Arm(tuple(sorted(some, key=lambda r: r.seed or 0))) for some in arms.values()]


def write_results(folder: Path, runs: Sequence[Run]) -> None:
    """Write `rows.jsonl` and `runs.json`, from which `read_runs` reads the same runs again.

    Args:
        folder: Where they go; what is there is replaced.
        runs: The runs; those without rows are left out.

    Raises:
        ConfigError: The folder has rows that are not among these.
    """
    runs = [run for run in runs if run.rows]
    check_replaces(folder, runs)
    folder.mkdir(parents=True, exist_ok=True)
    records = [
        {"run": i, "name": run.name, "seed": run.seed, "seconds": round(run.seconds), "settings":
         run.settings} for i, run in enumerate(runs)
    ]  # fmt: skip
    rows = ({"run": i, **_brief(row)} for i, run in enumerate(runs) for row in run.rows)
    with exclusive(folder / "rows.jsonl"):  # a row's number is that of its run in the other file
        write_together({
            folder / "rows.jsonl": "".join(map(line_of, rows)),
            folder / "runs.json": json.dumps(records, indent=1) + "\n",
        })  # fmt: skip


def check_replaces(folder: Path, runs: Sequence[Run]) -> None:
    """Refuses a folder whose rows would be lost if a report of these runs were written there.

    Args:
        folder: Where a report is to go.
        runs: What it is of.

    Raises:
        ConfigError: It is a run's folder, or has rows that are not among these runs'.
    """
    if (folder / "config.json").exists() or has_foreign(folder):
        raise ConfigError(f"{folder} is the folder of a run. Choose another --out.")
    if not (folder / "rows.jsonl").exists():
        return
    if not (folder / "runs.json").exists():
        raise ConfigError(
            f"{folder / 'rows.jsonl'} was not written by this command, which would replace it. "
            "Choose another --out."
        )
    # Settings that are newer than the report are not in it: the name and the seed do, too.
    new = {key: len(run.rows) for run in runs for key in (_key(run), (run.name, run.seed))}
    kept = [run for split in ("test", "validation") for run in read_results(folder, split)]
    same = {row.split for run in runs for row in run.rows}
    lost = [
        run.name
        for run in kept
        if run.rows
        and (
            run.rows[0].split not in same
            or max(new.get(_key(run), 0), new.get((run.name, run.seed), 0)) < len(run.rows)
        )
    ]
    if lost:
        raise ConfigError(
            f"{folder} has rollouts of {len(lost)} runs that would be lost, such as {lost[0]}: "
            f"they are not among those given. Give {folder} too, or choose another --out."
        )


def _key(run: Run) -> str:
    """What a run is known by: its settings and its seed."""
    return json.dumps([run.settings, run.seed], sort_keys=True)


def training_seconds(metrics: Sequence[Mapping[str, Any]]) -> float:
    """Wall time of a run: "seconds" counts from the start of a process, so a resumed run adds up.

    Args:
        metrics: Rows of metrics.jsonl.
    """
    total = last = 0.0
    for row in metrics:
        if (now := row.get("seconds")) is None:
            continue
        if now < last:
            total += last
        last = now
    return total + last


def _find(path: Path, known: set[Path]) -> Iterator[Path]:
    """The run and results folders at or below a path, each folder once: links may lead back.

    Results may have been written into a folder of runs, and then do not hide them.
    """
    if not path.is_dir() or (real := path.resolve()) in known:
        return
    known.add(real)
    is_run = (path / "config.json").is_file() or has_foreign(path)
    if is_run or (path / "rows.jsonl").is_file():
        yield path
    for child in [] if is_run else sorted(path.iterdir()):
        yield from _find(child, known)


def _read(folder: Path, split: str) -> list[Run]:
    if (folder / "config.json").is_file():
        return [_read_run(folder, split)]
    if has_foreign(folder):
        return [_read_foreign_run(folder, split)]
    if (folder / "runs.json").is_file():
        return read_results(folder, split)
    return _read_rows(folder, split)


def _read_run(folder: Path, split: str) -> Run:
    config = read_config(folder)
    rows = [row for row in latest_rows(read_run_rows(folder)) if row.split == split]
    settings = identity(config) | _ways(rows)
    if config.weights:
        settings["weights"] = _kind_of_weights(folder, config.weights)
    if config.dataset:
        settings["dataset"] = _content_of_data(folder, config.dataset)
    seconds = training_seconds(read_metrics(folder))
    return Run(folder.name, folder, settings, config.seed, rows, seconds)


def _read_foreign_run(folder: Path, split: str) -> Run:
    """Somebody else's policy: one arm with one run, of which no seed is known."""
    rows = [row for row in latest_rows(read_run_rows(folder)) if row.split == split]
    return Run(folder.name, folder, read_foreign(folder).settings | _ways(rows), None, rows)


def read_results(folder: Path, split: str) -> list[Run]:
    """The runs of a folder that `write_results` made: its rows have the number of their run.

    Args:
        folder: Of the results.
        split: Which pairs: "test" or "validation".

    Raises:
        DatasetError: One of its files is damaged.
    """
    lines: dict[int, list[tuple[str, Settings]]] = {}
    for number, line in enumerate(read_jsonl(folder / "rows.jsonl"), start=1):
        where = f"{folder / 'rows.jsonl'}, line {number}"
        if not isinstance(line, dict) or not isinstance(line.get("run"), int):
            raise DatasetError(f"{where}: expected a rollout with the number of its run.")
        lines.setdefault(line["run"], []).append((where, line))
    records = read_records(folder / "runs.json")
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
                   if k in USUAL_WAY and not isinstance(v, list)}  # fmt: skip
        given = lines.get(record.run, [])
        rows = of_one_run((where, Row.from_json(line | shared, where)) for where, line in given)
        rows = [row for row in latest_rows(rows) if row.split == split]
        runs.append(Run(record.name, None, record.settings, record.seed, rows, record.seconds))
    return runs


def _read_rows(folder: Path, split: str) -> list[Run]:
    """The runs of rows alone: their settings are known as far as rows say them."""
    file = folder / "rows.jsonl"
    of_runs: dict[tuple[Any, ...], list[tuple[str, Row]]] = {}
    for number, row in enumerate(read_rows(file), start=1):
        key = tuple(getattr(row, name) for name in (*NAMED, "seed", "run"))
        of_runs.setdefault(key, []).append((f"{file}, line {number}", row))
    runs = []
    for (*shared, seed, name), given in of_runs.items():
        rows = [row for row in latest_rows(of_one_run(given)) if row.split == split]
        settings = {k: v or NOT_RECORDED for k, v in zip(NAMED, shared, strict=True)}
        if rows:
            runs.append(Run(name or folder.name, None, settings | _ways(rows), seed, rows))
    return runs


def _merge(one: Run, other: Run) -> Run:
    """The rollouts of both; they are the same run, or it is an error."""
    known = {(row.step, row.pair): row for row in one.rows}
    for row in other.rows:
        before = known.setdefault((row.step, row.pair), row)
        if before.success != row.success:
            where = " and ".join(str(run.folder or run.name) for run in (one, other))
            raise ConfigError(
                f"{where} have the same settings and the same seed ({one.seed}), but pair "
                f"{row.pair} at step {row.step} ended differently. They are two runs of "
                "one thing: give only one of them."
            )
    return replace(one if one.folder else other, rows=list(known.values()))


def _check_pairs(runs: Iterable[Run]) -> None:
    """Refuses runs that were evaluated on different pairs; older rows have no hash of theirs."""
    first: dict[tuple[Any, ...], tuple[str, Run]] = {}
    for run in runs:
        s = run.settings
        for row in run.rows:
            if row.pair_sha is None:
                continue
            key = (s["task"], s["scene"], s.get("views"), row.split, row.pair)
            known, other = first.setdefault(key, (row.pair_sha, run))
            if known != row.pair_sha:
                raise ConfigError(
                    f"{other.folder or other.name} and {run.folder or run.name} were evaluated on "
                    f"different pairs of the same number ({row.pair}: {known} and {row.pair_sha}), "
                    "so they cannot be compared. Evaluate both with one version."
                )


def _ways(rows: Iterable[Row]) -> Settings:
    """How the policy was run."""
    used = {name: sorted({getattr(row, name) for row in rows}) for name in USUAL_WAY}
    return {k: USUAL_WAY[k] if not v else v[0] if len(v) == 1 else v for k, v in used.items()}


def _kind_of_weights(folder: Path, name: str) -> str:
    """What the weights are, and the start of their digest; their path if no record tells."""
    record = record_of_weights(folder)
    if record is None:
        return os.path.normpath(name)
    return f"{record.kind or Path(name).stem} {record.sha256[:8]}".rstrip()


def _content_of_data(folder: Path, name: str) -> str:
    """A dataset's name and the start of its fingerprint; its path if no checkpoint tells."""
    for side in sides(folder).values():
        return f"{Path(name).stem} {str(side['data'])[:8]}"
    return os.path.normpath(name)


def _brief(row: Row) -> Settings:
    brief = row.to_json(_KEPT)
    return {k: round(v, 3) if isinstance(v, float) else v for k, v in brief.items()}
