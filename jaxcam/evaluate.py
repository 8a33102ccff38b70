"""`python -m jaxcam.evaluate RUN…`: success on (initial state, camera pose) pairs never seen.

Every rollout is one row of `RUN/eval/rows.jsonl`.
"""

from jaxcam.commands import EvaluateConfig
from jaxcam.fields import cli

if __name__ == "__main__":
    cli(EvaluateConfig)  # --help and bad flags are answered before the slow imports

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from jaxcam.checkpoint import checkpoint_steps, load_policy_inputs
from jaxcam.config import TrainConfig
from jaxcam.errors import CheckpointError, JaxcamError, run_main
from jaxcam.evaluator import Evaluator, Row
from jaxcam.html import write_report
from jaxcam.locks import exclusive
from jaxcam.models import Policy, rebuild_policy
from jaxcam.pairs import store_pairs
from jaxcam.plots import write_plots
from jaxcam.progress import progress
from jaxcam.protocol import missing, protocol_of
from jaxcam.rundir import append_jsonl, read_jsonl
from jaxcam.sim.rollout import Rollouts
from jaxcam.stats import USUAL, Estimate, latest_rows, success_rate
from jaxcam.video import grid, write_video


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
    Several processes may evaluate one run; one waits for the other and goes on where it stopped.

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

    def rows_so_far() -> list[Row]:
        return _rows_of(file, evaluator, step, split, pairs)

    def to_run() -> list[int]:
        return missing(rows_so_far(), pairs)

    horizon = evaluator.task.horizon
    with exclusive(file, console):
        store_pairs(file.with_name(f"pairs-{split}.json"), evaluator.pairs(split, range(pairs)))
        batches = -(-len(to_run()) // evaluator.width)
        with progress(console, f"step {step}", horizon * batches) as advance:
            while some := to_run()[: evaluator.width]:
                steps = 0

                def tick() -> None:
                    nonlocal steps
                    steps += 1
                    advance()

                rows, done = evaluator.run(
                    policy, params, split, some, step=step, run=folder.name, tick=tick
                )
                advance(horizon - steps)
                append_jsonl(file, *rows, fsync=True)
                if videos:
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
    folder.mkdir(exist_ok=True)
    split, step = rows[0]["split"], rows[0]["step"]
    failures = [i for i, row in enumerate(rows) if row["status"] == "ok" and not row["success"]]
    for name, chosen in (("", [*range(len(rows))]), ("failures-", failures)):
        chosen = chosen[:most]
        if chosen:
            shown = [rows[i] for i in chosen]
            some = Rollouts(
                done.success[chosen], done.steps[chosen], done.ok[chosen], done.qpos[:, chosen]
            )
            clips = evaluator.clips(some, split, [row["pair"] for row in shown])
            write_video(folder / f"{name}{split}-{step:06d}.mp4", grid(clips, rows=shown), fps=10)


def evaluate_run(config: EvaluateConfig, folder: Path, console: Console) -> None:
    """Evaluates a run as the settings say, draws, and writes the run's report.

    Args:
        config: the settings; `run` in them may name other runs too.
        folder: of the run.
        console: for progress and results.

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
    for i, step in enumerate(steps):
        if not missing(_rows_of(file, evaluator, step, config.split, config.pairs), config.pairs):
            continue
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
            videos=0 if i else config.videos,
            console=console,
        )
    rows = [
        r
        for r in latest_rows(read_jsonl(file))
        if r["step"] in steps and r["split"] == config.split and r["pair"] < config.pairs
    ]
    write_plots(folder / "plots", read_jsonl(folder / "metrics.jsonl"), rows)
    what = f"{len(steps)} checkpoints" if len(steps) > 1 else f"step {steps[0]}"
    console.print(
        f"{folder.name}: success on {config.pairs} {config.split} pairs at {what}: "
        f"{success_rate(rows)}",
        soft_wrap=True,
    )
    console.print(f"Report: {write_report(folder)}", soft_wrap=True)
    if lacking:
        raise CheckpointError(" ".join(lacking))


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


def main() -> None:
    """The command line."""
    config = cli(EvaluateConfig)
    console = Console()
    errors = []
    for run in config.run:
        try:
            evaluate_run(config, Path(run), console)
        except JaxcamError as error:  # the other runs do not depend on this one
            if len(config.run) == 1:
                raise
            console.print(f"{run}: {error}", style="red", soft_wrap=True, markup=False)
            errors.append(error)
    if errors:
        raise errors[0]


if __name__ == "__main__":
    run_main(main)
