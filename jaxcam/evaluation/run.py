"""`python -m jaxcam.evaluate RUN…`: success on (initial state, camera pose) pairs never seen.

Every rollout is one row of `RUN/eval/rows.jsonl`.
"""

import contextlib
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from jaxcam.config.commands import EvaluateConfig
from jaxcam.config.train import TrainConfig
from jaxcam.console.progress import progress
from jaxcam.data.pairs import store_pairs
from jaxcam.devices import gathered, is_first, joined, memory_lacks, shard
from jaxcam.errors import CheckpointError, JaxcamError
from jaxcam.evaluation.evaluator import Evaluator, Row
from jaxcam.files.jsonl import append_jsonl, read_jsonl
from jaxcam.files.locks import exclusive
from jaxcam.files.video import grid, write_video
from jaxcam.models import Policy
from jaxcam.reports.run_figures import write_plots
from jaxcam.reports.run_page import write_report
from jaxcam.results.protocol import missing, protocol_of
from jaxcam.results.stats import USUAL, Estimate, latest_rows, success_rate
from jaxcam.sim.rollout import Rollouts
from jaxcam.training.checkpoint import checkpoint_steps, load_policy_inputs, rebuild_policy

_log = logging.getLogger(__name__)


def evaluate(
    evaluator: Evaluator,
    policy: Policy,
    params: Any,
    folder: Path,
    *,
    step: int,
    split: str = "test",
    pairs: int = 50,
    videos: int = 0,
    console: Console | None = None,
) -> Estimate:
    """Runs the pairs of a checkpoint that have no row yet, and writes rows, and two videos.

    A rollout that ends in an error is run once more; then it is counted, and told, as an error.
    The processes of one evaluation share its pairs, and the first of them writes. Separate
    evaluations of one run wait for each other and go on where the other stopped.

    Args:
        evaluator: of the run's task.
        policy: the policy.
        params: the checkpoint's parameters.
        folder: of the run.
        step: of the checkpoint.
        split: which pairs.
        pairs: how many, from number 0.
        videos: rollouts shown in a video; only those that are run now can be.
        console: for progress.

    Returns:
        The success rate over the pairs, with its interval.
    """
    file = folder / "eval" / "rows.jsonl"
    horizon, width = evaluator.task.horizon, evaluator.width
    (number, processes), writes = shard(), is_first()

    def rows_so_far() -> list[Row]:
        """As the first process reads them, since all are to see the same."""
        return gathered(_rows_of(file, evaluator, step, split, pairs) if writes else [])[0]

    def to_run() -> list[int]:
        return missing(rows_so_far(), pairs)

    with exclusive(file, console) if writes else contextlib.nullcontext():
        if writes:
            store_pairs(file.with_name(f"pairs-{split}.json"), evaluator.pairs(split, range(pairs)))
        turns = -(-len(to_run()) // (width * processes))
        with progress(console, f"step {step}", horizon * turns) as advance:
            while some := to_run()[: width * processes]:
                steps = 0

                def tick() -> None:
                    nonlocal steps
                    steps += 1
                    advance()

                each = -(-len(some) // processes)
                mine, rows, done = some[number * each : (number + 1) * each], [], None
                if mine:  # of a few pairs the last processes get none
                    with memory_lacks(f"A batch of {width} rollouts", f"--width {width // 2 or 1}"):
                        rows, done = evaluator.run(
                            policy, params, split, mine, step=step, run=folder.name, tick=tick
                        )
                advance(horizon - steps)
                every = [row for part in gathered(rows) for row in part]
                if writes:
                    append_jsonl(file, *every, fsync=True)
                if writes and done and videos:
                    _write_videos(folder / "videos", evaluator, rows, done, videos)
                    videos = 0
    return success_rate(latest_rows(rows_so_far()))


def _rows_of(file: Path, evaluator: Evaluator, step: int, split: str, pairs: int) -> list[Row]:
    """The rows that the evaluator would write for a checkpoint."""
    same = {
        "step": step,
        "split": split,
        "width": evaluator.width,
        "engine": evaluator.engine_name,
        "ensemble": evaluator.ensemble,
    }
    rows = [USUAL | r for r in read_jsonl(file)]
    return [r for r in rows if r["pair"] < pairs and all(r[k] == same[k] for k in same)]


def _write_videos(
    folder: Path, evaluator: Evaluator, rows: Sequence[Row], done: Rollouts, most: int
) -> None:
    """A video of the first rollouts, and one of the first failures."""
    split, step = rows[0]["split"], rows[0]["step"]
    first = list(range(len(rows)))[:most]
    failures = [i for i, row in enumerate(rows) if row["status"] == "ok" and not row["success"]]
    failures = failures[:most]
    shown = sorted({*first, *failures})
    some = Rollouts(done.success[shown], done.steps[shown], done.ok[shown], done.qpos[:, shown])
    drawn = evaluator.clips(some, split, [rows[i]["pair"] for i in shown])
    clips = dict(zip(shown, drawn, strict=True))
    for name, chosen in (("", first), ("failures-", failures)):
        if chosen:
            file = folder / f"{name}{split}-{step:06d}.mp4"
            try:
                tiles = grid([clips[i] for i in chosen], rows=[rows[i] for i in chosen])
                write_video(file, tiles, fps=10)
            except OSError as error:  # of a full disk, for example: the rows matter more
                _log.warning("The video %s could not be written: %s.", file, error)


def evaluate_run(config: EvaluateConfig, folder: Path, console: Console | None) -> None:
    """Evaluates a run as the settings say, draws, and writes the run's report.

    Args:
        config: the settings; `run` in them may name other runs too.
        folder: of the run.
        console: for progress and results; silent when None.

    Raises:
        CheckpointError: a checkpoint that is asked for is damaged or missing; the others are done.
    """
    inputs = load_policy_inputs(folder, config.step)
    steps, lacking = [inputs.step], []
    if config.protocol == "paper":
        steps, lacking = _steps(folder, inputs.config)
    policy = rebuild_policy(inputs)
    evaluator = Evaluator(inputs.config, config.width, config.engine, config.ensemble)
    file = folder / "eval" / "rows.jsonl"

    def lacks_rows(step: int) -> bool:
        rows = _rows_of(file, evaluator, step, config.split, config.pairs)
        return bool(missing(rows, config.pairs))

    for step in gathered([step for step in steps if lacks_rows(step)])[0]:
        try:
            if step != inputs.step:
                inputs = load_policy_inputs(folder, step)
        except CheckpointError as error:
            lacking.append(str(error))
            continue
        evaluate(
            evaluator,
            policy,
            inputs.params,
            folder,
            step=step,
            split=config.split,
            pairs=config.pairs,
            videos=config.videos if step == steps[0] else 0,
            console=console,
        )
    if is_first():
        _conclude(config, folder, steps, console)
    if lacking:
        raise CheckpointError(" ".join(lacking))


def _conclude(
    config: EvaluateConfig, folder: Path, steps: Sequence[int], console: Console | None
) -> None:
    """Draws, writes the run's report and tells the result."""
    rows = [
        r
        for r in latest_rows(read_jsonl(folder / "eval" / "rows.jsonl"))
        if r["step"] in steps and r["split"] == config.split and r["pair"] < config.pairs
    ]
    write_plots(folder / "plots", read_jsonl(folder / "metrics.jsonl"), rows)
    report = write_report(folder)
    if console:
        what = f"{len(steps)} checkpoints" if len(steps) > 1 else f"step {steps[0]}"
        console.print(
            f"{folder.name}: success on {config.pairs} {config.split} pairs at {what}: "
            f"{success_rate(rows)}",
            soft_wrap=True,
        )
        console.print(f"Report: {report}", soft_wrap=True)


def _steps(folder: Path, trained: TrainConfig) -> tuple[list[int], list[str]]:
    """Checkpoints of the protocol that are there, and what is said of those that are not."""
    wanted = protocol_of(trained.policy).steps(trained.steps, trained.save_every)
    there = checkpoint_steps(folder)
    if wanted[0] not in there:
        raise CheckpointError(
            f"{folder} is trained to step {max(there)} of {wanted[0]}. Finish its training before "
            "its last checkpoints are evaluated."
        )
    gone = ", ".join(str(step) for step in wanted if step not in there)
    told = [f"{folder} has no checkpoints of the steps {gone}; the others are evaluated."]
    return [step for step in wanted if step in there], told if gone else []


def main(config: EvaluateConfig, console: Console) -> None:
    """Runs the command."""
    with joined(config.distributed):
        evaluate_runs(config, console if is_first() else None)


def evaluate_runs(config: EvaluateConfig, console: Console | None = None) -> None:
    """Evaluates the runs that the settings name, each as well as it can be.

    Args:
        config: the settings.
        console: for progress and results; silent when None.

    Raises:
        JaxcamError: a run could not be evaluated; the others are done.
    """
    errors = []
    for run in config.run:
        try:
            evaluate_run(config, Path(run), console)
        except JaxcamError as error:  # the other runs do not depend on this one
            if len(config.run) == 1:
                raise
            if console:
                console.print(f"{run}: {error}", style="red", soft_wrap=True, markup=False)
            errors.append(error)
    if errors:
        raise errors[0]
