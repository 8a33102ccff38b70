"""What a run writes while it trains: checkpoints, metrics, and loggers that were asked for."""

import logging
from collections.abc import Mapping
from typing import Any, Self

import numpy as np

from jaxcam.config.train import TrainConfig
from jaxcam.files.whole import whole
from jaxcam.runs.folder import RunDir
from jaxcam.training.checkpoint import Checkpoints
from jaxcam.training.loggers import Loggers
from jaxcam.training.state import TrainState

_log = logging.getLogger(__name__)


class Records:
    """The records of one run. Close them when done.

    Args:
        run: Its folder; None in a process that writes nothing.
        config: Its settings.
        side: What is saved beside its arrays, see `jaxcam.training.side.make_side`.
    """

    def __init__(self, run: RunDir | None, config: TrainConfig, side: Mapping[str, Any]) -> None:
        self._run, self._config, self._side = run, config, side
        self._checkpoints = Checkpoints(run.checkpoints, keep=config.keep) if run else None
        self._loggers: Loggers | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        if self._loggers:
            self._loggers.close()
        if self._checkpoints:
            self._checkpoints.close()

    def restore(self, fresh: TrainState) -> TrainState:
        """The newest whole state; rows of later updates are dropped.

        Args:
            fresh: The state before the first update, which is the newest if none was saved.
        """
        if self._run is None or self._checkpoints is None:
            return fresh
        restored = self._checkpoints.restore_latest(fresh, expect=self._side)
        state = restored.state if restored else fresh
        step = int(state.step)
        self._run.rewind(step)
        self._loggers = Loggers(self._config.log, self._run.path, self._config, step)
        return state

    def log(self, row: Mapping[str, Any]) -> None:
        """Write down a row of metrics. A disk that is full loses rows, not the training."""
        if self._run is None:
            return
        self._run.check_there()
        try:
            self._run.log(row)
        except OSError as error:
            _log.warning("Metrics of update %d are lost: %s.", row["step"], error)
        if self._loggers:
            self._loggers.log(row)

    def keep_batch(self, batch: Mapping[str, Any]) -> None:
        """Write down the batch at which the run diverged, `diverged.npz`."""
        if self._run:
            with whole(self._run.path / "diverged.npz") as part:
                np.savez(part, **batch)

    def save(self, state: TrainState) -> None:
        """Write a checkpoint."""
        if self._run and self._checkpoints:
            self._run.check_there()
            self._checkpoints.save(state, self._side)
