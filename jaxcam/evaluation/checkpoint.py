"""The evaluation of one policy: all processes run what is missing, the first one writes."""

import contextlib
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from jaxcam.console.paces import rollouts_job
from jaxcam.console.progress import progress
from jaxcam.data.pairs import store_pairs
from jaxcam.devices import gathered, is_first, memory_lacks, shard
from jaxcam.errors import DatasetError
from jaxcam.evaluation.evaluator import Evaluated, Evaluator
from jaxcam.files.jsonl import append_jsonl
from jaxcam.files.locks import exclusive
from jaxcam.files.video import grid, write_video
from jaxcam.reports.names import file_name
from jaxcam.results.protocol import missing
from jaxcam.results.rows import Row
from jaxcam.results.stats import Estimate, latest_rows, success_rate
from jaxcam.runs.rollouts import read_run_rows, rows_file
from jaxcam.sim.rollout import Rollouts

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Wanted:
    """What is asked of an evaluation.

    Attributes:
        split: Which pairs: "test", "validation" or "train".
        pairs: How many, from number 0.
        videos: Rollouts shown in a video; only those that are run now can be.
    """

    split: str = "test"
    pairs: int = 50
    videos: int = 0


def evaluate(
    evaluator: Evaluator, candidate: Evaluated, wanted: Wanted, console: Console | None = None
) -> Estimate:
    """Runs the pairs of a checkpoint that have no row yet, and writes rows, and two videos.

    A rollout whose simulator fails is run once more; then it is reported and left out. One whose
    policy gives no actions has failed, and is not run again.
    The processes of one evaluation share its pairs, and the first of them writes. Separate
    evaluations of one run wait for each other and go on where the other stopped.

    Args:
        evaluator: Of the run's task.
        candidate: The checkpoint, or the foreign policy.
        wanted: Which pairs, and how many videos.
        console: For progress; silent when None.

    Returns:
        The success rate over the pairs, with its interval.

    Raises:
        DatasetError: The run was evaluated on other pairs, its rows are damaged, or they are of
            another run or other weights.
        ConfigError: A batch of rollouts does not fit into memory.
    """
    file = rows_file(candidate.folder)
    with exclusive(file, console) if is_first() else contextlib.nullcontext():
        if is_first():
            pairs = evaluator.pairs(wanted.split, range(wanted.pairs))
            store_pairs(file.with_name(f"pairs-{wanted.split}.json"), pairs)
        rows = _run_missing(evaluator, candidate, wanted, console)
    return success_rate(latest_rows(rows))


def rows_of(rows: Sequence[Row], evaluator: Evaluator, step: int, wanted: Wanted) -> list[Row]:
    """Those rows that the evaluator would write for a checkpoint.

    Args:
        rows: Of a run, from `read_run_rows`.
        evaluator: Rows of another width, engine, ensembling or of other conditions are not its.
        step: Updates of the checkpoint.
        wanted: Which pairs.
    """
    way = (evaluator.width, evaluator.engine_name, evaluator.ensemble)
    same = (step, wanted.split, way, tuple(evaluator.conditions.said.values()))
    return [
        row
        for row in rows
        if row.pair < wanted.pairs and (row.step, row.split, row.way, row.conditions) == same
    ]


def _run_missing(
    evaluator: Evaluator, candidate: Evaluated, wanted: Wanted, console: Console | None
) -> list[Row]:
    """Runs batch after batch until nothing is missing; all rows of the checkpoint."""
    (number, processes), horizon = shard(), evaluator.task.horizon
    most, draw = evaluator.width * processes, wanted.videos > 0
    rows = _rows_so_far(evaluator, candidate, wanted)
    turns = -(-len(missing(rows, wanted.pairs)) // most)
    what = f"step {candidate.step}" if candidate.step else "rollouts"
    what = ", ".join(filter(None, [what, evaluator.conditions.words]))
    job = rollouts_job(evaluator.task.name, evaluator.engine_name, evaluator.width)
    with progress(console, what, horizon * turns, job=job) as advance:
        while batch := missing(rows, wanted.pairs)[:most]:
            each = -(-len(batch) // processes)
            mine, clock = batch[number * each : (number + 1) * each], _Clock(advance)
            written, done = _run_batch(evaluator, candidate, wanted.split, mine, clock)
            clock.end(horizon)
            if done and draw:
                _write_videos(evaluator, candidate, wanted, written, done)
                draw = False
            rows = _rows_so_far(evaluator, candidate, wanted)
    return rows


def _rows_so_far(evaluator: Evaluator, candidate: Evaluated, wanted: Wanted) -> list[Row]:
    """The checkpoint's rows as the first process reads them, since all are to see the same."""
    rows = _own_rows(candidate) if is_first() else []
    rows = rows_of(rows, evaluator, candidate.step, wanted)
    return _shared(rows)[0]


def _own_rows(candidate: Evaluated) -> list[Row]:
    """The rows of the candidate's run; those of its step were made with its weights."""
    rows = read_run_rows(candidate.folder)
    for row in rows:
        other = row.weights_sha not in (None, candidate.weights_sha)
        if row.step == candidate.step and other:
            raise DatasetError(
                f"{rows_file(candidate.folder)} has rows of other weights of step {row.step} "
                f"({row.weights_sha}; those to evaluate are {candidate.weights_sha}): the run was "
                f"trained anew, or the rows are another's. Move {candidate.folder / 'eval'} away."
            )
    return rows


def _shared(rows: Sequence[Row]) -> list[list[Row]]:
    """The rows of each process, in all of them."""
    parts = gathered([row.to_json() for row in rows])
    return [[Row.from_json(row) for row in part] for part in parts]


class _Clock:
    """Shows the control steps of a batch, of which one that ends early has fewer."""

    def __init__(self, advance: Callable[..., None]) -> None:
        self._advance, self._steps = advance, 0

    def tick(self) -> None:
        self._steps += 1
        self._advance()

    def end(self, horizon: int) -> None:
        self._advance(horizon - self._steps)


def _run_batch(
    evaluator: Evaluator, candidate: Evaluated, split: str, pairs: Sequence[int], clock: _Clock
) -> tuple[list[Row], Rollouts | None]:
    """Runs this process's pairs and writes the rows of all processes; the first has its rollouts.

    Of a few pairs the last processes get none.
    """
    rows, done, width = [], None, evaluator.width
    if pairs:
        with memory_lacks(f"A batch of {width} rollouts", f"--width {width // 2 or 1}"):
            rows, done = evaluator.run(candidate, split, pairs, clock.tick)
    parts = _shared(rows)
    if not is_first():
        return rows, None
    lines = [row.to_json() for part in parts for row in part]
    append_jsonl(rows_file(candidate.folder), *lines, fsync=True)
    return rows, done


def _write_videos(
    evaluator: Evaluator,
    candidate: Evaluated,
    wanted: Wanted,
    rows: Sequence[Row],
    done: Rollouts,
) -> None:
    """A video of the first rollouts, and one of the first failures."""
    first = list(range(len(rows)))[: wanted.videos]
    failures = [i for i, row in enumerate(rows) if row.finished and not row.success]
    failures = failures[: wanted.videos]
    shown = sorted({*first, *failures})
    some = Rollouts(done.success[shown], done.steps[shown], done.ok[shown], done.qpos[:, shown],
                    done.acted[shown])  # fmt: skip
    drawn = evaluator.clips(some, wanted.split, [rows[i].pair for i in shown])
    clips = dict(zip(shown, drawn, strict=True))
    for name, chosen in (("", first), ("failures-", failures)):
        if chosen:
            folder: Path = candidate.folder / "videos"
            words = "-".join([wanted.split, *evaluator.conditions.words.split()])
            safe = file_name(words)  # lenses are written with colons
            file = folder / f"{name}{safe}-{candidate.step:06d}.mp4"
            try:
                tiles = grid([clips[i] for i in chosen], rows=[rows[i] for i in chosen])
                write_video(file, tiles, fps=10)
            except OSError as error:  # of a full disk, for example: the rows matter more
                _log.warning("The video %s could not be written: %s.", file, error)
