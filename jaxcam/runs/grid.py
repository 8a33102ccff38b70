"""Grids of runs: a YAML file that says what is trained, and what of it is done.

A file has these entries:

    title: what it is for
    runs_dir: runs/laptop        # folder of its runs
    protocol: paper              # evaluation after training: paper, or one (the last checkpoint)
    settings:                    # flags of `python -m jaxcam.train` that all runs share
      {preset: laptop, seed: [0, 1, 2]}
    runs:                        # each entry is every combination of its values and the shared ones
      - {task: lift, conditioning: [late, keypoints], twins: true}
    evaluations:                 # more of them, by flags of `python -m jaxcam.evaluate` that say
      - {pose_noise: ["1,1", "2,2"]}                     # conditions: each is every combination
    slurm: {timeout_min: 480}    # for submitit, where runs are sent to a cluster

With `twins`, each run that is told its cameras brings its own image-only twin: the same network,
fed with one fixed pose. That is what its gain is counted from.

A run's folder is named by its settings, not by the file, so files that share runs train them once.
"""

import dataclasses
import itertools
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from jaxcam.config.conditions import Conditions, of_task, several
from jaxcam.config.fields import as_record, short
from jaxcam.config.names import ProtocolName
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError, closest
from jaxcam.files.paths import home
from jaxcam.files.yaml import read_yaml
from jaxcam.results.protocol import missing, protocol_of
from jaxcam.results.rows import Row
from jaxcam.results.stats import Estimate, latest_rows, success_rate
from jaxcam.runs.identity import (
    differences,
    full_name,
    resolve,
    stored_config,
    twin_settings,
)
from jaxcam.runs.metrics import read_metrics
from jaxcam.runs.rollouts import read_run_rows
from jaxcam.sim import engine_name, make_task

PYTHON = (sys.executable, "-m")
"""How a command of jaxcam is started."""

MOST_RUNS = 100_000
"""Combinations of values that an entry of a file may have."""


@dataclass(frozen=True)
class _File:
    """What is in a file, as far as its form goes."""

    runs_dir: str
    runs: list[Any]
    title: str | None = None
    protocol: Any = None
    settings: dict[str, Any] | None = None
    evaluations: list[Any] | None = None
    slurm: dict[str, Any] | None = None


_ENTRIES = tuple(f.name for f in dataclasses.fields(_File))
_CONDITIONS = tuple(f.name for f in dataclasses.fields(Conditions))
_FIELDS = {f.name: f for f in dataclasses.fields(TrainConfig)}
_OURS = ("run_dir",)
_NAMES = (*_FIELDS, "twins")


@dataclass(frozen=True)
class Planned:
    """A run of a grid.

    Attributes:
        folder: Of the run.
        given: Its settings as the file gives them; the others are the preset's.
        config: All its settings.
        protocol: Its evaluation, "one" or "paper".
        evaluations: Further ones under other conditions: values by name, each of which is every
            combination of them.
    """

    folder: Path
    given: Mapping[str, Any]
    config: TrainConfig
    protocol: ProtocolName
    evaluations: tuple[Mapping[str, tuple[str, ...]], ...] = ()

    @property
    def conditions(self) -> list[Conditions]:
        """All that it is evaluated under, each once: its own, and those of further evaluations."""
        fovy = make_task(self.config.task).fovy_deg
        usual = self.config.conditions
        everything = [usual, *(c for asked in self.evaluations for c in several(usual, asked))]
        return list(dict.fromkeys(of_task(c, fovy) for c in everything))

    @property
    def name(self) -> str:
        """Name of its folder."""
        return self.folder.name

    @property
    def steps(self) -> list[int]:
        """Checkpoints that it is evaluated at."""
        if self.protocol == "one":
            return [self.config.steps]
        asked = protocol_of(self.config.policy)
        return asked.steps(self.config.steps, self.config.save_every)

    @property
    def pairs(self) -> int:
        """Pairs that each of them is evaluated on."""
        if self.protocol == "one":
            return self.config.pairs
        return protocol_of(self.config.policy).pairs

    def commands(self) -> list[list[str]]:
        """The commands that make it, in order; run again, each goes on where it stopped."""
        words = [*PYTHON, "jaxcam.train"]
        for name, value in self.given.items():
            values = value if isinstance(value, list | tuple) else (value,)
            words += [_flag(name), *map(str, values)] if values else []
        train = [*words, "--run-dir", str(self.folder)]
        evaluate = [*PYTHON, "jaxcam.evaluate", str(self.folder)]
        if self.protocol == "one":
            steps, pairs = str(self.config.steps), str(self.pairs)
            evaluate += ["--step", steps, "--pairs", pairs]
            first = []
        else:
            evaluate += ["--protocol", "paper"]
            first = [[*evaluate]]
        more = [
            [
                *evaluate,
                *(word for name, values in asked.items() for word in (_flag(name), *values)),
            ]
            for asked in self.evaluations
        ]
        return [train, *first, *more]


@dataclass(frozen=True)
class Grid:
    """What a file plans.

    Attributes:
        title: What it is for.
        runs_dir: Folder of its runs.
        runs: The runs, each once.
        slurm: Parameters for submitit.
    """

    title: str
    runs_dir: Path
    runs: list[Planned]
    slurm: Mapping[str, Any]


@dataclass(frozen=True)
class Standing:
    """How far a run is.

    Attributes:
        step: Updates done.
        rollouts: Rollouts that are done of those asked for.
        asked: Rollouts asked for.
        estimate: Success so far.
    """

    step: int
    rollouts: int
    asked: int
    estimate: Estimate

    @property
    def done(self) -> bool:
        """Whether nothing is left to do."""
        return self.rollouts == self.asked


def read_grid(path: str | Path) -> Grid:
    """The runs that a file plans.

    Args:
        path: YAML file.

    Raises:
        ConfigError: It is no such file, or an entry, a setting or a value in it is unknown.
    """
    path = home(path)
    where = str(path)
    content = _mapping(where, read_yaml(path), _ENTRIES)
    for name in ("runs_dir", "runs"):
        if not content.get(name):
            raise ConfigError(f"{where}: there is no '{name}'.")
    file = as_record(_File, content, where)
    protocol = file.protocol or "one"
    if protocol not in (known := get_args(ProtocolName)):
        raise ConfigError(f"{where}: unknown protocol '{protocol}'{closest(str(protocol), known)}")
    shared = _mapping(f"{where}, settings", file.settings or {}, _NAMES)
    evaluations = tuple(
        _evaluation(f"{where}, evaluation {i}", asked)
        for i, asked in enumerate(file.evaluations or (), start=1)
    )
    runs: dict[Path, Planned] = {}
    for i, block in enumerate(file.runs, start=1):
        place = f"{where}, run {i}"
        values = {**shared, **_mapping(place, block, _NAMES)}
        twins = values.pop("twins", False)
        if not isinstance(twins, bool):
            raise ConfigError(f"{place}: 'twins' must be true or false, got {short(twins)}.")
        for given in _combinations(place, values, twins=twins):
            planned = _plan(place, home(file.runs_dir), given, protocol)
            planned = dataclasses.replace(planned, evaluations=evaluations)
            known = runs.setdefault(planned.folder, planned)
            if changed := differences(known.config, planned.config):
                raise ConfigError(
                    f"{place}: two runs would share the folder {planned.name}, since they differ "
                    f"only in {', '.join(d.field for d in changed)}, which makes no other run. "
                    "Leave one of them out."
                )
    planned = [*runs.values()]
    return Grid(file.title or path.stem, home(file.runs_dir), planned, file.slurm or {})


def progress_of(run: Planned) -> Standing:
    """How far a run is, from its folder.

    Raises:
        DatasetError: Its metrics or its rows are damaged, or rows in its folder are not its own.
        ConfigError: Its config.json is damaged, or is that of another run, such as of one that was
            made when the preset had other values.
    """
    if (run.folder / "config.json").is_file() and (others := _others(run.folder, run.config)):
        raise ConfigError(
            f"{run.folder} is of a run with other settings ({'; '.join(others)}). Presets may have "
            "had other values when it was made: state its own in the grid, or move it away."
        )
    metrics = read_metrics(run.folder)
    step = int(max((row["step"] for row in metrics), default=0))
    rows = [
        row
        for row in read_run_rows(run.folder)
        if row.split == "test" and row.step in run.steps and row.pair < run.pairs
    ]
    said = [tuple(conditions.said.values()) for conditions in run.conditions]
    evaluations = [(s, c) for s in run.steps for c in said]
    asked = len(evaluations) * run.pairs
    to_run = sum(
        _to_run([r for r in rows if (r.step, r.conditions) == one], run.pairs)
        for one in evaluations
    )
    own = [row for row in latest_rows(rows) if row.conditions == said[0]]
    return Standing(step, asked - to_run, asked, success_rate(own))


def _others(folder: Path, config: TrainConfig) -> list[str]:
    """In what the run of a folder is another one; machines have their own steps per call."""
    changed = differences(stored_config(folder), config)
    return [str(d) for d in changed if d.changes_program and d.field != "steps_per_call"]


def _to_run(rows: Sequence[Row], pairs: int) -> int:
    """Pairs that a checkpoint's evaluation lacks: rows of several ways do not make up for them."""
    ways: dict[Any, list[Row]] = {}
    for row in rows:
        ways.setdefault(row.way, []).append(row)
    return min((len(missing(some, pairs)) for some in ways.values()), default=pairs)


def _flag(name: str) -> str:
    return "--" + name.replace("_", "-")


def _evaluation(where: str, asked: Any) -> dict[str, tuple[str, ...]]:
    """Values of conditions by name; each may be one or a list."""
    values = {
        name: tuple(str(v) for v in (value if isinstance(value, list) else [value]))
        for name, value in _mapping(where, asked, _CONDITIONS).items()
    }
    try:
        several(Conditions(), values)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from error
    return values


def _plan(where: str, runs_dir: Path, given: dict[str, Any], protocol: ProtocolName) -> Planned:
    config = _resolved(where, given)
    if "seed" not in given:
        raise ConfigError(f"{where}: there is no 'seed'.")
    name = _folder(runs_dir, config)
    planned = Planned(runs_dir / name, given, config, protocol)
    asked = protocol_of(config.policy).checkpoints
    kept = min(len(planned.steps), config.keep)
    if protocol == "paper" and kept < asked:
        raise ConfigError(
            f"{where}: the protocol takes the last {asked} checkpoints, but {name} keeps {kept} "
            f"(steps {config.steps:,}, save_every {config.save_every:,}, keep {config.keep}). "
            f"Set save_every to {config.steps // asked} or less, and keep to {asked} or more."
        )
    return planned


def _resolved(where: str, given: Mapping[str, Any]) -> TrainConfig:
    """The settings of a run in full."""
    if given.get("preset", "auto") == "auto":
        raise ConfigError(
            f"{where}: there is no 'preset'. A grid says which, since the machine that trains may "
            "not be the one that plans."
        )
    try:
        config = resolve(TrainConfig(**given), accelerator=False)
        if config.engine != "auto":
            engine_name(config.engine, make_task(config.task))
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from error
    return config


def _folder(runs_dir: Path, config: TrainConfig) -> str:
    """Name of the run's folder: the one of version 0.1.0 where this run has that already."""
    name, old = full_name(config), full_name(config, files=False)
    if name == old or not (runs_dir / old / "config.json").is_file():
        return name
    try:
        there = stored_config(runs_dir / old)
    except ConfigError:
        return name
    files = ("data_dir", "dataset", "weights")
    same = all(getattr(there, k) == getattr(config, k) for k in files)
    return old if same else name


def _mapping(where: str, content: Any, known: Any) -> dict[str, Any]:
    """The content, if it is a mapping whose names are known."""
    if not isinstance(content, dict):
        raise ConfigError(f"{where}: expected names with values, got {short(content)}.")
    for name in content:
        if name not in known or name in _OURS:
            names = [k for k in known if k not in _OURS]
            raise ConfigError(f"{where}: unknown setting '{name}'{closest(str(name), names)}.")
    return content


def _combinations(
    where: str, values: Mapping[str, Any], *, twins: bool
) -> Iterator[dict[str, Any]]:
    """Every combination of the values, and its twin if that is asked for.

    A list is several values, of `model` a list of lists.
    """
    choices = []
    for name, value in values.items():
        several = isinstance(value, list)
        if name == "model":
            lists = isinstance(value, list) and {isinstance(v, list) for v in value}
            if lists not in (set(), {True}, {False}):
                raise ConfigError(
                    f"{where}: 'model' must be a list of name=value, or a list of such lists, got "
                    f"{short(value)}."
                )
            several = lists == {True}
            value = [tuple(v) for v in value] if several else tuple(value)
        if several and not value:
            raise ConfigError(f"{where}: '{name}' is an empty list.")
        choices.append(value if several else [value])
    if (count := math.prod(map(len, choices))) > MOST_RUNS:
        raise ConfigError(f"{where}: {count:,} combinations, more than {MOST_RUNS:,}.")
    for combination in itertools.product(*choices):
        given = dict(zip(values, combination, strict=True))
        yield given
        if twins and (twin := _twin(where, given)):
            yield twin


def _twin(where: str, given: Mapping[str, Any]) -> dict[str, Any] | None:
    """The image-only twin of a run; None of one that is image-only itself."""
    config = _resolved(where, given)
    if config.conditioning == "none":
        return None
    twin = {**given, **twin_settings(config)}
    return (
        twin
        if twin["model"] or "model" in given
        else {k: v for k, v in twin.items() if k != "model"}
    )
