"""What a training will do and how long each part takes here: its first lines."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from jaxcam.config.datasets import CollectConfig
from jaxcam.config.train import TrainConfig
from jaxcam.console.paces import (
    collecting_job,
    expected_seconds,
    in_words,
    rollouts_job,
    training_job,
)
from jaxcam.data.collection import dataset_path
from jaxcam.runs.identity import RECORDED
from jaxcam.sim import engine_name, make_task
from jaxcam.training.checkpoint import checkpoint_steps

WIDTH = 50
"""Rollouts at once of the evaluation that ends a training."""


@dataclasses.dataclass(frozen=True)
class Stretch:
    """A part of a training.

    Attributes:
        what: In words.
        seconds: That it takes here, as far as is known.
        is_timed: Whether a time is told at all: what is there takes none.
    """

    what: str
    seconds: float | None = None
    is_timed: bool = True

    def __str__(self) -> str:
        return f"{self.what}: {in_words(self.seconds)}" if self.is_timed else self.what


def stages(configs: Sequence[TrainConfig]) -> list[Stretch]:
    """The parts of a training, in order.

    Args:
        configs: Resolved settings of its runs, which differ in their seed.
    """
    config = configs[0]
    is_simulated = config.task != RECORDED
    parts = [_demonstrations(config)] if is_simulated else [Stretch(config.dataset, is_timed=False)]
    drawn = "drawn" if is_simulated else "decoded"
    parts.append(Stretch(f"their pictures, {drawn} once and kept", is_timed=False))
    done = min(max(checkpoint_steps(c.run_dir), default=0) for c in configs)
    updates = f"{config.steps - done} updates of {config.batch}"
    updates += f", from {done} on" if done else ""
    updates += f", of {len(configs)} seeds side by side" if len(configs) > 1 else ""
    pace = expected_seconds(training_job(config, len(configs)), config.steps - done)
    parts.append(Stretch(updates, pace))
    if is_simulated:
        task = make_task(config.task)
        steps = task.horizon * -(-config.pairs // WIDTH) * len(configs)
        job = rollouts_job(task.name, engine_name(config.engine, task), WIDTH)
        rollouts = f"{config.pairs} rollouts seen by cameras that it never saw"
        parts.append(Stretch(rollouts, expected_seconds(job, steps)))
    return parts


def _demonstrations(config: TrainConfig) -> Stretch:
    """The demonstrations of a task: there, or collected first."""
    file = Path(config.dataset) if config.dataset else dataset_path(CollectConfig.of(config))
    if config.dataset or file.exists():
        return Stretch(f"demonstrations, which are there: {file}", is_timed=False)
    count = config.demos + config.validation
    seconds = expected_seconds(collecting_job(config.task, config.scene), count)
    return Stretch(f"{count} demonstrations are collected", seconds)


def show_plan(configs: Sequence[TrainConfig], console: Console) -> None:
    """Prints what comes.

    Args:
        configs: Resolved settings of the runs, which differ in their seed.
        console: Where.
    """
    config = configs[0]
    camera = "not told its camera" if config.conditioning == "none" else config.conditioning
    seeds = ", ".join(str(c.seed) for c in configs)
    lines = [
        f"{config.task}: {config.policy}, preset {config.preset}, {camera}, seed {seeds}",
        *(f"  {number}. {stage}" for number, stage in enumerate(stages(configs), 1)),
        f"Then {Path(config.run_dir) / 'report.html'}. Ctrl-C saves; the same command goes on.",
    ]
    for line in lines:
        console.print(line, soft_wrap=True, highlight=False)
