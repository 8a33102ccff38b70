"""`python -m jaxcam.evaluate RUN…`: success on (initial state, camera pose) pairs never seen.

Every rollout is one row of `RUN/eval/rows.jsonl`. Somebody else's policy is evaluated by
`jaxcam.evaluation.foreign`.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from jaxcam.config.commands import EvaluateConfig
from jaxcam.config.conditions import Conditions
from jaxcam.config.train import TrainConfig
from jaxcam.data.pairs import cameras_seen
from jaxcam.devices import gathered, is_first, joined
from jaxcam.errors import CheckpointError, ConfigError, JaxcamError
from jaxcam.evaluation.checkpoint import Wanted, evaluate, rows_of
from jaxcam.evaluation.evaluator import Candidate, Evaluator
from jaxcam.evaluation.foreign import evaluate_foreign
from jaxcam.files.paths import absolute
from jaxcam.reports.run_figures import write_plots
from jaxcam.reports.run_page import write_report
from jaxcam.results.protocol import missing, protocol_of
from jaxcam.results.rows import SEEN
from jaxcam.results.stats import latest_rows, success_rate
from jaxcam.runs.identity import RECORDED, read_config
from jaxcam.runs.manifests import sides
from jaxcam.runs.metrics import read_metrics
from jaxcam.runs.rollouts import as_usual, read_run_rows
from jaxcam.training.checkpoint import checkpoint_steps, load_policy_inputs, rebuild_policy


def evaluate_run(config: EvaluateConfig, folder: Path, console: Console | None) -> None:
    """Evaluates a run as the settings say, draws, and writes the run's report.

    Args:
        config: The settings; `run` in them may name other runs too.
        folder: Of the run.
        console: For progress and results; silent when None.

    Raises:
        CheckpointError: A checkpoint that is asked for is damaged or missing; the others are done.
    """
    inputs = load_policy_inputs(folder, config.step)
    if inputs.config.task == RECORDED:
        raise ConfigError(
            f"{folder} learned from recorded episodes, and there is no simulator of those. The "
            f"errors of its actions are in {folder / 'report.html'}."
        )
    steps, lacking = [inputs.step], []
    if config.protocol == "paper":
        steps, lacking = steps_to_judge(folder, inputs.config)
    policy = rebuild_policy(inputs)
    trained_on = None
    if config.split == SEEN:
        data = next((str(side["data"]) for side in sides(folder).values()), None)
        trained_on = cameras_seen(inputs.config, data)
    wanted = Wanted(config.split, config.pairs)
    for conditions in config.conditions(inputs.config.conditions):
        evaluator = Evaluator(
            inputs.config, config.width, config.engine, config.ensemble, conditions, trained_on
        )
        rows = read_run_rows(folder)
        open_steps = [
            s for s in steps if missing(rows_of(rows, evaluator, s, wanted), wanted.pairs)
        ]
        for step in gathered(open_steps)[0]:
            try:
                if step != inputs.step:
                    inputs = load_policy_inputs(folder, step)
            except CheckpointError as error:
                lacking += [] if str(error) in lacking else [str(error)]
                continue
            videos = config.videos if step == steps[0] else 0
            candidate = Candidate(policy, inputs.params, folder, step)
            evaluate(evaluator, candidate, replace(wanted, videos=videos), console)
        if is_first():
            _conclude(config, folder, steps, evaluator.conditions, console)
    if lacking:
        raise CheckpointError(" ".join(lacking))


def _conclude(
    config: EvaluateConfig,
    folder: Path,
    steps: Sequence[int],
    conditions: Conditions,
    console: Console | None,
) -> None:
    """Draws, writes the run's report and tells the result under some conditions."""
    all_rows = [
        r
        for r in latest_rows(read_run_rows(folder))
        if r.step in steps and r.split == config.split and r.pair < config.pairs
    ]
    if config.split != SEEN:  # the plots are of held-out cameras
        usual = as_usual(all_rows, read_config(folder))
        write_plots(folder / "plots", read_metrics(folder), usual)
    report = write_report(folder)
    rows = [row for row in all_rows if row.conditions == tuple(conditions.said.values())]
    if console:
        what = f"{len(steps)} checkpoints" if len(steps) > 1 else f"step {steps[0]}"
        words = f"{what}, {conditions.words}" if conditions.words else what
        pairs = f"{config.split} pairs"
        if config.split == SEEN:
            pairs = "new starts seen by training's cameras (memory, no result)"
        console.print(
            f"{folder.name}: success on {config.pairs} {pairs} at {words}: {success_rate(rows)}",
            soft_wrap=True,
            markup=False,
        )
        console.print(f"Report: {report}", soft_wrap=True, markup=False)


def steps_to_judge(folder: Path, trained: TrainConfig) -> tuple[list[int], list[str]]:
    """Which checkpoints the protocol judges a run by.

    Args:
        folder: Of the run.
        trained: The run's settings.

    Returns:
        Steps of those that are there, the newest first, and a sentence about those that are not.

    Raises:
        CheckpointError: The last one is not there, so the training has not ended.
    """
    wanted = protocol_of(trained.policy).steps(trained.steps, trained.save_every)
    there = checkpoint_steps(folder)
    if wanted[0] not in there:
        raise CheckpointError(
            f"{folder} is trained to step {max(there)} of {wanted[0]}. Finish its training before "
            "its last checkpoints are evaluated."
        )
    gone = ", ".join(str(step) for step in wanted if step not in there)
    sentence = f"{folder} has no checkpoints of the steps {gone}; the others are evaluated."
    return [step for step in wanted if step in there], [sentence] if gone else []


def main(config: EvaluateConfig, console: Console) -> None:
    """Runs the command."""
    if config.foreign.policy:
        evaluate_foreign(config, console)
        return
    with joined(config.distributed):
        evaluate_runs(config, console if is_first() else None)


def evaluate_runs(config: EvaluateConfig, console: Console | None = None) -> None:
    """Evaluates the runs that the settings name, each as well as it can be.

    Args:
        config: The settings.
        console: For progress and results; silent when None.

    Raises:
        JaxcamError: A run could not be evaluated; the others are done.
    """
    errors = []
    for run in config.run:
        try:
            evaluate_run(config, absolute(run), console)
        except JaxcamError as error:  # the other runs do not depend on this one
            if len(config.run) == 1:
                raise
            if console:
                console.print(f"{run}: {error}", style="red", soft_wrap=True, markup=False)
            errors.append(error)
    if errors:
        raise errors[0]
