"""Runs, read from run folders, results folders, packs, or folders that hold such."""

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from jaxcam.errors import ConfigError
from jaxcam.files.paths import absolute
from jaxcam.interrupts import check_stop
from jaxcam.reports.arms import Run, kind_of_pairs
from jaxcam.reports.packs.folder import read_results, run_key
from jaxcam.reports.packs.pack import Pack, is_pack, read_pack
from jaxcam.reports.packs.records import NAMED
from jaxcam.results.protocol import NOT_RECORDED, is_foreign
from jaxcam.results.rows import CONDITIONS, SEEN, Row
from jaxcam.results.stats import latest_rows
from jaxcam.runs.foreign import has_foreign, read_foreign_record
from jaxcam.runs.identity import Settings, identity, read_config, usual_way
from jaxcam.runs.manifests import record_of_weights, sides
from jaxcam.runs.metrics import read_metrics
from jaxcam.runs.rollouts import of_one_run, read_rows, read_run_rows

_MARKS = ("digest", "evaluation")
"""Settings that tell somebody's policies of one name apart, which a report adds to them."""


def read_runs(paths: Iterable[str | Path], split: str = "test") -> list[Run]:
    """All runs in and below folders; each run once, however often it is met.

    Args:
        paths: Run folders, results folders, or folders that hold such.
        split: Which pairs: "test", "validation" or "train".

    Raises:
        ConfigError: A folder has no run, two runs of the same settings and seed disagree, or a pair
            of one run is not the pair of that number in another.
    """
    runs: dict[str, list[Run]] = {}
    for path in map(absolute, paths):
        folders = list(_find(path, set()))
        if not folders:
            raise ConfigError(
                f"No run in {path}: neither it nor a folder below it has a config.json or a "
                "rows.jsonl."
            )
        for folder in folders:
            check_stop()
            for run in map(_without_marks, _read(folder, split)):
                _take_in(runs.setdefault(run_key(run), []), run)
    _check_pairs(run for alike in runs.values() for run in alike)
    return [run for alike in runs.values() for run in _told_apart(alike)]


def read_packs(paths: Iterable[str | Path]) -> list[Pack]:
    """All packs in and below folders, each once, with pairs that can be compared.

    Args:
        paths: Packs, or folders that hold packs.

    Raises:
        ConfigError: A folder has none, or rows that are in no pack; or a pair of one pack is not
            the pair of that number in another.
        DatasetError: A pack is damaged.
    """
    packs: dict[str, Pack] = {}
    for path in map(absolute, paths):
        folders = list(_find(path, set()))
        if loose := [folder for folder in folders or [path] if not is_pack(folder)]:
            raise ConfigError(
                f"{loose[0]} is no pack, since it has no pack.json. A leaderboard is made of "
                f"packs: python -m jaxcam.report {loose[0]} --pack FOLDER makes one."
            )
        for folder in folders:
            check_stop()
            pack = read_pack(folder)
            packs.setdefault(pack.manifest.digest, pack)
    _check_pairs(run for pack in packs.values() for run in _runs_of(pack))
    return list(packs.values())


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
    is_whole = (path / "config.json").is_file() or has_foreign(path) or is_pack(path)
    if is_whole or (path / "rows.jsonl").is_file():
        yield path
    for child in [] if is_whole else sorted(path.iterdir()):
        yield from _find(child, known)


def _read(folder: Path, split: str) -> list[Run]:
    if is_pack(folder):
        runs = _runs_of(read_pack(folder))
        return [replace(run, rows=[r for r in run.rows if r.split == split]) for run in runs]
    if (folder / "config.json").is_file():
        return _read_run(folder, split)
    if has_foreign(folder):
        return _read_foreign(folder, split)
    if (folder / "runs.json").is_file():
        return read_results(folder, split)
    return _read_rows(folder, split)


def _runs_of(pack: Pack) -> list[Run]:
    """The runs of a pack, which say what it was written with."""
    source = f"{pack.folder} ({pack.manifest.written_with()})"
    return [replace(run, source=source) for run in pack.runs]


def _read_run(folder: Path, split: str) -> list[Run]:
    """A run under each of the conditions that it was evaluated under."""
    config = read_config(folder)
    settings = identity(config)
    if config.weights:
        settings["weights"] = _kind_of_weights(folder, config.weights)
    if config.dataset:
        settings["dataset"] = _content_of_data(folder, config.dataset)
    seconds = training_seconds(read_metrics(folder))
    run = Run(folder.name, folder, settings, config.seed, [], seconds, str(folder))
    return _under_each(run, latest_rows(read_run_rows(folder)), split)


def _read_foreign(folder: Path, split: str) -> list[Run]:
    """Somebody else's policy: one run, of which no seed is known."""
    settings = read_foreign_record(folder).settings
    run = Run(folder.name, folder, settings, None, [], source=str(folder))
    return _under_each(run, latest_rows(read_run_rows(folder)), split)


def _under_each(run: Run, rows: Sequence[Row], split: str) -> list[Run]:
    """A run with the rows of each of its conditions; one without rows if there are none."""
    groups: dict[tuple[str | None, ...], list[Row]] = {}
    for row in rows:
        if row.split == split:
            groups.setdefault(row.conditions, []).append(row)
    if not groups:
        return [replace(run, settings=run.settings | _ways([], run.settings["task"]))]
    return [
        replace(
            run,
            settings=run.settings | _ways(some, run.settings["task"]) | _varied(conditions),
            rows=some,
        )
        for conditions, some in groups.items()
    ]


def _varied(conditions: Sequence[str | None]) -> Settings:
    """The conditions that are not as usual."""
    said = zip(CONDITIONS, conditions, strict=True)
    return {name: value for name, value in said if value is not None}


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
        run = Run(name or folder.name, None, settings, seed, [], source=str(folder))
        runs += _under_each(run, rows, split) if rows else []
    return runs


def _take_in(alike: list[Run], run: Run) -> None:
    """Adds a run to those of the same settings and seed: to one of them, if it is that one.

    Anybody's two policies may have one name and the same settings, and are two then.
    """
    for i, one in enumerate(alike):
        if not is_foreign(run.settings["policy"]) or _may_be_one(one, run):
            alike[i] = _merge(one, run)
            return
    alike.append(run)


def _may_be_one(one: Run, other: Run) -> bool:
    """Whether nothing is known by which rollouts are of two policies."""
    shas = _shas(one) | _shas(other)
    return len(shas) < 2 and _contradiction(one, other) is None


def _shas(run: Run) -> set[str]:
    """The digests of what acted, as far as the rows say them."""
    return {row.weights_sha for row in run.rows if row.weights_sha}


def _contradiction(one: Run, other: Run) -> Row | None:
    """A rollout of the other run that ended differently in the one."""
    known = {(row.step, row.pair): row.success for row in one.rows}
    return next(
        (r for r in other.rows if known.get((r.step, r.pair), r.success) != r.success), None
    )


def _without_marks(run: Run) -> Run:
    """A run without what an earlier report told it apart by."""
    if not (is_foreign(run.settings["policy"]) and run.settings.keys() & set(_MARKS)):
        return run
    kept = {name: value for name, value in run.settings.items() if name not in _MARKS}
    return replace(run, settings=kept)


def _told_apart(alike: Sequence[Run]) -> list[Run]:
    """Runs of the same settings and seed with what tells them apart, where there are several."""
    if len(alike) == 1:
        return list(alike)
    known = ["".join(sorted(_shas(run)))[:8] for run in alike]
    marked = []
    for i, (run, sha) in enumerate(zip(alike, known, strict=True)):
        marks: Settings = {"digest": sha} if sha else {}
        if known.count(sha) > 1:
            marks["evaluation"] = known[: i + 1].count(sha)
        marked.append(replace(run, settings=run.settings | marks))
    return marked


def _merge(one: Run, other: Run) -> Run:
    """The rollouts of both; they are the same run, or it is an error."""
    if (row := _contradiction(one, other)) is not None:
        raise ConfigError(
            f"{one.source} and {other.source} have the same settings and the same seed "
            f"({one.seed}), but pair {row.pair} at step {row.step} ended differently. They are "
            "two runs of one thing: give only one of them."
        )
    known = {(row.step, row.pair): row for row in one.rows}
    for row in other.rows:
        known.setdefault((row.step, row.pair), row)
    return replace(one if one.folder else other, rows=list(known.values()))


def _check_pairs(runs: Iterable[Run]) -> None:
    """Refuses runs that were evaluated on different pairs; older rows have no hash of theirs."""
    first: dict[tuple[Any, ...], tuple[str, Run]] = {}
    for run in runs:
        kind = kind_of_pairs(run.settings)
        for row in run.rows:
            if row.pair_sha is None:
                continue
            # Pairs on cameras that training saw are the same where these are.
            cameras = _cameras_of(run.settings) if row.split == SEEN else ()
            of_kind = (*kind, *cameras, row.split, row.pair)
            known, other = first.setdefault(of_kind, (row.pair_sha, run))
            if known != row.pair_sha:
                raise ConfigError(
                    f"{other.source} and {run.source} were evaluated on different pairs of the "
                    f"same number: pair {row.pair} of {kind[0]}, {kind[1]}, {row.split}, is "
                    f"{known} in the one and {row.pair_sha} in the other. It starts from another "
                    "state or is seen by other cameras, as with another version of jaxcam, MuJoCo "
                    "or robosuite, so they cannot be compared. Evaluate both with one version, or "
                    "leave one of them out."
                )


def _cameras_of(settings: Settings) -> tuple[Any, ...]:
    """What the cameras of a run's demonstrations follow from."""
    return tuple(settings.get(name) for name in ("demos", "n", "m", "dataset"))


def _ways(rows: Iterable[Row], task: str) -> Settings:
    """How the policy was run; where it was not, how it would be."""
    usual = usual_way(task)
    used = {name: sorted({getattr(row, name) for row in rows}) for name in usual}
    return {k: usual[k] if not v else v[0] if len(v) == 1 else v for k, v in used.items()}


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
