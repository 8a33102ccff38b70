"""Where a run's demonstrations come from: simulated here, or recorded by somebody.

This is all that training asks of them; nothing after it knows which kind it has.
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from rich.console import Console

from jaxcam.config.train import TrainConfig
from jaxcam.data.batches import Dataset
from jaxcam.errors import ConfigError
from jaxcam.files.paths import absolute
from jaxcam.models import Policy
from jaxcam.pipeline.recorded import Recorded
from jaxcam.pipeline.simulated import Simulated
from jaxcam.runs.folder import RunDir
from jaxcam.runs.identity import RECORDED
from jaxcam.runs.interface import Interface
from jaxcam.training.state import TrainState


class Source(Protocol):
    """Demonstrations, and what becomes of a policy that has learned from them."""

    @property
    def prompts(self) -> tuple[str, ...]:
        """What they show, in words; several where samples say which by number."""
        ...

    def complete(self, config: TrainConfig) -> TrainConfig:
        """The settings with those that the demonstrations decide.

        Raises:
            ConfigError: A setting that is given does not go with them.
        """
        ...

    def sizes(self, config: TrainConfig) -> tuple[int, int]:
        """Numbers of an action, and of what the robot feels.

        Args:
            config: Resolved settings.
        """
        ...

    def base_from_actions(self, config: TrainConfig) -> np.ndarray:
        """The frame that grip poses of the actions are in [4, 4].

        Args:
            config: Settings.
        """
        ...

    def interface(self, config: TrainConfig) -> Interface:
        """What a policy that has learned from them is shown and answers, by name.

        Args:
            config: Resolved settings.
        """
        ...

    def dataset(self, configs: Sequence[TrainConfig], console: Console | None) -> Dataset:
        """The arrays that runs of these settings, which differ in their seed, are trained on."""
        ...

    def conclude(
        self,
        config: TrainConfig,
        run: RunDir | None,
        policy: Policy,
        state: TrainState,
        dataset: Dataset,
        console: Console | None,
    ) -> None:
        """Evaluate what was trained, draw, and write the report.

        Args:
            config: Resolved settings.
            run: The run's folder; None in a process that writes nothing.
            policy: What was trained.
            state: Where training ended.
            dataset: What it was trained on.
            console: For progress and results; silent when None.
        """
        ...


def source_of(config: TrainConfig, console: Console | None = None) -> Source:
    """What a run learns from: a folder that `dataset` names was recorded, all else is simulated.

    Args:
        config: Settings.
        console: For what reading a folder tells; silent when None.

    Raises:
        ConfigError: The settings name a task and a folder that do not go together.
        DatasetError: The folder is no recorded dataset, or is damaged.
    """
    if config.dataset and absolute(config.dataset).is_dir():
        if config.task not in (TrainConfig.task, RECORDED):
            raise ConfigError(
                f"{config.dataset} is a recorded dataset and shows what it shows: leave --task "
                f"{config.task} out."
            )
        return Recorded.open(config, console)
    if config.task == RECORDED:
        raise ConfigError(
            "--task recorded needs the folder of a recorded dataset as --dataset; got "
            f"{config.dataset or 'none'}."
        )
    return Simulated(config.task)
