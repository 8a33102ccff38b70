"""`python -m jaxcam.evaluate --policy …`: somebody else's policy on our pairs.

It is evaluated as a checkpoint is, by the same evaluator; only who is asked differs.
"""

import contextlib
import dataclasses
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, get_args

from rich.console import Console

from jaxcam.config.commands import EvaluateConfig
from jaxcam.config.fields import as_record
from jaxcam.config.foreign import ForeignConfig, ObsMap
from jaxcam.config.names import ActionSpace, PolicyName, Rotations, TaskName
from jaxcam.config.sizes import rows_and_columns, size_name
from jaxcam.errors import ConfigError
from jaxcam.evaluation.asking import Asking
from jaxcam.evaluation.checkpoint import Wanted, evaluate
from jaxcam.evaluation.evaluator import Evaluator
from jaxcam.evaluation.mapping import Names, names_of_map, read_map, renamed, view_names, write_map
from jaxcam.evaluation.sources import Function, Server, Source
from jaxcam.files.paths import absolute, home, read_text
from jaxcam.reports.names import file_name
from jaxcam.reports.run_figures import write_plots
from jaxcam.reports.run_page import write_report
from jaxcam.results.stats import causes, latest_rows, success_rate
from jaxcam.runs.environment import record_environment
from jaxcam.runs.foreign import ForeignRecord, adopt
from jaxcam.runs.identity import USUAL_SPACE
from jaxcam.runs.rollouts import read_run_rows
from jaxcam.sim import engine_name, make_task, simulator_of
from jaxcam.sim.actions import action_dim
from jaxcam.sim.rollout import Agent
from jaxcam.sim.world import PROPRIO_DIM

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]{0,79}")
_SIDE: Final = 84
"""Pixels of pictures of which nobody says how large they are to be."""


@dataclass(frozen=True)
class Foreign:
    """A candidate that is somebody else's policy.

    Attributes:
        record: Who it is, and how it is asked.
        source: Where it is.
        names: What it is sent.
        folder: Of its rows.
    """

    record: ForeignRecord
    source: Source
    names: Names
    folder: Path
    step: int = 0

    @property
    def weights_sha(self) -> str:
        """Digest of what is known of it, which ties rows to it."""
        return self.record.weights_sha

    @contextlib.contextmanager
    def acting(self, evaluator: Evaluator) -> Iterator[Agent]:
        """The policy as the rollouts of one batch ask it."""
        record, size = self.record, action_dim(evaluator.space)
        asking = Asking(self.source, self.names, record.prompt, record.answer, size, record.execute)
        with asking.at_work():
            yield Agent(
                asking,
                evaluator.space,
                execute=record.execute,
                obs_steps=record.observation_steps,
                causes=asking.causes,
            )


def evaluate_foreign(config: EvaluateConfig, console: Console | None) -> Path:
    """Evaluates somebody else's policy as the settings say, draws, and writes its page.

    Args:
        config: The settings.
        console: For progress and results; silent when None.

    Returns:
        The folder.

    Raises:
        ConfigError: The settings or the map are wrong, or the folder is of another policy.
        NoServerError: There is no such server, or it is gone; rows of whole batches are kept.
        PortError: The policy refuses what it is sent.
    """
    flags = config.foreign
    wanted = read_map(flags.obs) if flags.obs else ObsMap()
    source = source_of(flags, config.width)
    record, names = record_of(flags, wanted, source)
    engine = _engine(config.engine, record)
    make_task(record.task).require()
    folder = absolute(flags.run_dir or f"runs/foreign-{record.task}-{record.scene}-{record.name}")
    adopt(folder, record)
    record_environment(folder)
    write_map(folder / "obs.yaml", map_of(record))
    if console:
        console.print(_told(record, names), soft_wrap=True, highlight=False)
    evaluator = Evaluator(record, config.width, engine)
    candidate = Foreign(record, source, names, folder)
    wanted_pairs = Wanted(config.split, config.pairs, config.videos)
    evaluate(evaluator, candidate, wanted_pairs, console)
    _conclude(config, folder, console)
    return folder


def source_of(flags: ForeignConfig, width: int) -> Source:
    """Where the policy is that the flags name.

    Args:
        flags: The settings.
        width: Rollouts at once, of which one object cannot remember several.

    Raises:
        ConfigError: There is no such function, or it cannot be asked by so many.
        NoServerError: There is no such server.
    """
    if flags.is_server:
        key = _key(flags)
        return Server(flags.policy, key, flags.timeout, flags.at_once or 0)
    function = Function(flags.policy)
    if function.remembers and width > 1:
        raise ConfigError(
            f"--policy {flags.policy} has reset(), so it remembers an episode, and {width} are run "
            "at once. Name its class, of which each gets an object of its own, or give --width 1."
        )
    return function


def _key(flags: ForeignConfig) -> str:
    if not flags.key_file:
        return flags.key
    try:
        return read_text(home(flags.key_file)).strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"--key-file {flags.key_file} cannot be read: {error}.") from error


def record_of(flags: ForeignConfig, wanted: ObsMap, source: Source) -> tuple[ForeignRecord, Names]:
    """What is asked of a policy, and how: flags come first, then the map, then what it says itself.

    Args:
        flags: The settings.
        wanted: The map.
        source: The policy.

    Returns:
        The record, and what it is sent.

    Raises:
        ConfigError: A value of these cannot be.
    """
    said = Said.of(source.metadata)
    task = flags.task or said.task or "lift"
    views = flags.views or len(said.views or ()) or make_task(task).views
    resolution = flags.resolution or wanted.resolution or said.resolution or _SIDE
    space = flags.action_space or wanted.action_space or said.action_space or USUAL_SPACE
    record = ForeignRecord(
        name=_name(flags, source),
        address=source.address,
        task=task,
        scene=flags.scene,
        conditioning=said.conditioning or "none",
        views=views,
        resolution=size_name(*rows_and_columns(resolution)),
        action_space=space,
        rotations=(said.rotations or "nominal") if space == "eef_abs" else "nominal",
        execute=flags.execute or wanted.execute or said.execute,
        observation_steps=wanted.observation_steps or said.observation_steps or 1,
        keys=wanted.keys,
        answer=wanted.answer,
        prompt=wanted.prompt or make_task(task).prompt,
        metadata=source.metadata,
        weights_sha=source.sha,
    )
    if wanted.keys is not None:
        return record, names_of_map(wanted.keys, views, PROPRIO_DIM)
    theirs = list(said.views or ()) if len(said.views or ()) == views else view_names(views)
    return record, renamed(theirs)


@dataclass(frozen=True)
class Said:
    """What a policy says of itself that we use, if it is of a form that we know."""

    run: str | None = None
    task: TaskName | None = None
    conditioning: str | None = None
    views: tuple[str, ...] | None = None
    resolution: int | str | None = None
    action_space: ActionSpace | None = None
    rotations: Rotations | None = None
    execute: int | None = None
    observation_steps: int | None = None

    @classmethod
    def of(cls, metadata: Mapping[str, Any]) -> "Said":
        """What is in the metadata of a server or of a function; others say anything, or nothing."""
        return cls(
            run=_said(metadata.get("run"), str),
            task=_named(metadata.get("task"), TaskName),
            conditioning=_said(metadata.get("conditioning"), str),
            views=_texts(metadata.get("views")),
            resolution=_size(metadata.get("image_size")),
            action_space=_named(metadata.get("action_space"), ActionSpace),
            rotations=_named(metadata.get("rotations"), Rotations),
            execute=_count(metadata.get("execute")),
            observation_steps=_count(metadata.get("observation_steps")),
        )


def _said(value: Any, kind: type) -> Any:
    return value if isinstance(value, kind) and value else None


def _named(value: Any, names: Any) -> Any:
    return value if isinstance(value, str) and value in get_args(names) else None


def _count(value: Any) -> int | None:
    is_count = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= 1000
    return value if is_count else None


def _texts(value: Any) -> tuple[str, ...] | None:
    if not isinstance(value, list):
        return None
    texts = tuple(value)
    return texts if texts and all(isinstance(text, str) for text in texts) else None


def _size(value: Any) -> int | str | None:
    if not (isinstance(value, list) and len(value) == 2 and all(map(_count, value))):
        return None
    return size_name(*value)


def _name(flags: ForeignConfig, source: Source) -> str:
    """What the policy is called; a name that it has by itself is made one of a file."""
    ours = get_args(PolicyName)
    if not flags.name:
        given = Said.of(source.metadata).run or re.sub(r"^wss?://|[/:]+", " ", flags.policy).strip()
        safe = file_name(given.replace(" ", "-"))[:80]
        return f"foreign-{safe}" if safe in ours or not _NAME.fullmatch(safe) else safe
    if not _NAME.fullmatch(flags.name):
        raise ConfigError(
            f"--name {flags.name!r:.100}: expected at most 80 letters, digits and _ . + -, since "
            "it is part of a folder's name."
        )
    if flags.name in ours:
        raise ConfigError(f"--name {flags.name} is the name of a policy of ours. Choose another.")
    return flags.name


def _engine(asked: str, record: ForeignRecord) -> str:
    """What simulates: of engines that ask a policy from within a program, none."""
    task = make_task(record.task)
    if asked != "auto":
        return engine_name(asked, task)
    chosen = engine_name("auto", task)
    return next(iter(simulator_of(task).engines)) if chosen.startswith("mjx") else chosen


def map_of(record: ForeignRecord) -> ObsMap:
    """The map that asks for what was sent, whoever said it."""
    known = {f.name for f in dataclasses.fields(ObsMap)}
    return as_record(ObsMap, {k: v for k, v in vars(record).items() if k in known}, "map")


def _told(record: ForeignRecord, names: Names) -> str:
    """How a policy is asked, in words."""
    rows, columns = rows_and_columns(record.resolution)
    steps = f"{record.execute} steps" if record.execute else "all steps"
    several = f", the last {record.observation_steps}" if record.observation_steps > 1 else ""
    return (
        f"{record.name} ({record.address}) on {record.task}, {record.scene} scene: {record.views} "
        f"view{'s' if record.views > 1 else ''} of {rows} x {columns}{several}; actions are "
        f"{record.action_space}, {steps} of a chunk are executed. It is sent {', '.join(names)}."
    )


def _conclude(config: EvaluateConfig, folder: Path, console: Console | None) -> None:
    """Draws, writes the page and tells the result."""
    rows = [
        row
        for row in latest_rows(read_run_rows(folder))
        if row.split == config.split and row.pair < config.pairs
    ]
    write_plots(folder / "plots", [], rows)
    page = write_report(folder)
    if console:
        console.print(
            f"{folder.name}: success on {config.pairs} {config.split} pairs: {success_rate(rows)}",
            soft_wrap=True,
        )
        for line in causes(rows):
            console.print(line, soft_wrap=True, highlight=False, markup=False)
        console.print(f"Page: {page}", soft_wrap=True)
