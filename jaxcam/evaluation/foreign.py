"""`python -m jaxcam.evaluate --policy …`: somebody else's policy on our pairs.

It is evaluated as a checkpoint is, by the same evaluator; only who is asked differs.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from jaxcam.config.commands import EvaluateConfig
from jaxcam.config.conditions import Conditions
from jaxcam.config.foreign import ForeignConfig, ObsMap
from jaxcam.config.sizes import rows_and_columns
from jaxcam.console.words import plain_line
from jaxcam.errors import ConfigError, NoServerError
from jaxcam.evaluation.asking import Asking
from jaxcam.evaluation.checkpoint import Wanted, evaluate
from jaxcam.evaluation.evaluator import Evaluator
from jaxcam.evaluation.mapping import Names, read_map, write_map
from jaxcam.evaluation.sources import PolicyFunction, PolicyServer, PolicySource
from jaxcam.evaluation.terms import map_of, names_sent, settled
from jaxcam.files.keys import read_key
from jaxcam.files.paths import absolute, home
from jaxcam.reports.run_figures import write_plots
from jaxcam.reports.run_page import write_report
from jaxcam.results.stats import causes, latest_rows, success_rate
from jaxcam.runs.environment import record_environment
from jaxcam.runs.foreign import ForeignRecord, keep_record
from jaxcam.runs.rollouts import as_usual, read_run_rows
from jaxcam.sim import engine_name, make_task, simulator_of
from jaxcam.sim.actions import action_dim
from jaxcam.sim.rollout import Agent


@dataclass(frozen=True)
class ForeignPolicy:
    """Somebody else's policy, which is evaluated.

    Attributes:
        record: Who it is, and how it is asked.
        source: Where it is.
        names: What it is sent.
        folder: Of its rows.
    """

    record: ForeignRecord
    source: PolicySource
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
    source = policy_source(flags, config.width)
    record = settled(flags, wanted, source)
    names = names_sent(record, config.width)
    engine = _engine(config.engine, record)
    make_task(record.task).require()
    folder = absolute(flags.run_dir or f"runs/foreign-{record.task}-{record.scene}-{record.name}")
    keep_record(folder, record)
    record_environment(folder)
    write_map(folder / "obs.yaml", map_of(record))
    if console:
        words = plain_line(_told(record, names))
        console.print(words, soft_wrap=True, highlight=False, markup=False)
    candidate = ForeignPolicy(record, source, names, folder)
    wanted_pairs = Wanted(config.split, config.pairs, config.videos)
    for conditions in config.conditions(Conditions()):
        evaluator = Evaluator(record, config.width, engine, conditions=conditions)
        try:
            evaluate(evaluator, candidate, wanted_pairs, console)
        except NoServerError as error:
            raise NoServerError(
                f"{error} Rollouts of the batches that were finished are kept, and the same "
                "command goes on with the others."
            ) from error
        _conclude(config, folder, evaluator.conditions, record, console)
    return folder


def policy_source(flags: ForeignConfig, width: int) -> PolicySource:
    """Where the policy is that the flags name.

    Args:
        flags: The settings.
        width: Rollouts at once, of which one object cannot remember several.

    Raises:
        ConfigError: There is no such function, or it cannot be asked by so many.
        NoServerError: There is no such server.
    """
    if flags.is_server:
        key = flags.key
        if flags.key_file:
            key = read_key(home(flags.key_file), "--key-file")
        return PolicyServer(flags.policy, key, flags.timeout, flags.at_once or 0)
    function = PolicyFunction(flags.policy)
    if function.remembers and width > 1:
        raise ConfigError(
            f"--policy {flags.policy} has reset(), so it remembers an episode, and {width} are run "
            "at once. Name its class, of which each gets an object of its own, or give --width 1."
        )
    return function


def _engine(asked: str, record: ForeignRecord) -> str:
    """What simulates: of engines that ask a policy from within a program, none."""
    task = make_task(record.task)
    if asked != "auto":
        return engine_name(asked, task)
    chosen = engine_name("auto", task)
    return next(iter(simulator_of(task).engines)) if chosen.startswith("mjx") else chosen


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


def _conclude(
    config: EvaluateConfig,
    folder: Path,
    conditions: Conditions,
    record: ForeignRecord,
    console: Console | None,
) -> None:
    """Draws, writes the page and tells the result under some conditions."""
    all_rows = [
        row
        for row in latest_rows(read_run_rows(folder))
        if row.split == config.split and row.pair < config.pairs
    ]
    write_plots(folder / "plots", [], as_usual(all_rows, record))
    page = write_report(folder)
    rows = [row for row in all_rows if row.conditions == tuple(conditions.said.values())]
    words = f", {conditions.words}" if conditions.words else ""
    if console:
        console.print(
            f"{folder.name}: success on {config.pairs} {config.split} pairs{words}: "
            f"{success_rate(rows)}",
            soft_wrap=True,
            markup=False,
        )
        for line in causes(rows):
            console.print(line, soft_wrap=True, highlight=False, markup=False)
        console.print(f"Page: {page}", soft_wrap=True, markup=False)
