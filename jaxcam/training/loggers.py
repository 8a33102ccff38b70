"""Metrics to TensorBoard and Weights & Biases, beside a run's metrics.jsonl.

Neither can stop a run: what fails is told once, and the run goes on without it.
"""

import dataclasses
import importlib
import importlib.util
import logging
import uuid
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.files.whole import write_atomically

PACKAGES = {"tensorboard": "tensorboardX", "wandb": "wandb"}
"""What each needs."""

_log = logging.getLogger(__name__)


class Logger(Protocol):
    """Takes rows of metrics."""

    def log(self, row: Mapping[str, Any]) -> None:
        """Take a row; `step` in it is the update."""
        ...

    def close(self) -> None:
        """Write what is left."""
        ...


def check_loggers(names: Sequence[str]) -> None:
    """Refuses loggers whose package is not installed.

    Args:
        names: Of loggers.

    Raises:
        ConfigError: One is missing.
    """
    for name in names:
        if importlib.util.find_spec(PACKAGES[name]) is None:
            raise ConfigError(
                f"--log {name} needs the package {PACKAGES[name]}: pip install 'jaxcam[{name}]', "
                "or leave it out."
            )


class Loggers:
    """The loggers of a run; a fault in one of them ends it, and nothing else.

    Args:
        names: Which.
        folder: Of the run.
        config: Of the run.
        step: Update that the run goes on from; rows of later ones are written again.
    """

    def __init__(self, names: Sequence[str], folder: Path, config: TrainConfig, step: int) -> None:
        self._loggers: dict[str, Logger] = {}
        for name in names:
            self._try(name, lambda name=name: self._open(name, folder, config, step))

    def _open(self, name: str, folder: Path, config: TrainConfig, step: int) -> None:
        self._loggers[name] = _KINDS[name](folder, config, step)

    def log(self, row: Mapping[str, Any]) -> None:
        """Give them a row."""
        for name, logger in list(self._loggers.items()):
            self._try(name, lambda logger=logger: logger.log(row))

    def close(self) -> None:
        """Let them write what is left."""
        for name, logger in list(self._loggers.items()):
            self._try(name, logger.close)
        self._loggers.clear()

    def _try(self, name: str, do: Callable[[], None]) -> None:
        try:
            do()
        except Exception as error:  # A network, a server or a disk failed, in whatever way.
            _log.warning("%s failed, the run goes on without it: %s", name, error)
            self._loggers.pop(name, None)


class _TensorBoard:
    def __init__(self, folder: Path, config: TrainConfig, step: int) -> None:
        del config
        package = importlib.import_module(PACKAGES["tensorboard"])
        # An earlier start may have written rows that are now written again: they are hidden.
        # Files are named by the second, in which a start may follow another.
        self._writer = package.SummaryWriter(
            str(folder / "tensorboard"), purge_step=step + 1, filename_suffix=f".{step}"
        )

    def log(self, row: Mapping[str, Any]) -> None:
        for name, value in row.items():
            if name != "step":
                self._writer.add_scalar(name, value, row["step"])

    def close(self) -> None:
        self._writer.close()


class _Wandb:
    def __init__(self, folder: Path, config: TrainConfig, step: int) -> None:
        del step
        package = importlib.import_module(PACKAGES["wandb"])
        identity = folder / "wandb.txt"
        if not identity.exists():  # Before anything is sent, so that no run is sent twice.
            write_atomically(identity, uuid.uuid4().hex[:12] + "\n")
        self._run = package.init(
            project="jaxcam", name=folder.name, id=identity.read_text().strip(), resume="allow",
            dir=str(folder), config=dataclasses.asdict(config), reinit="create_new",
            settings=package.Settings(console="off"),
        )  # fmt: skip
        # By our own step, since a run that goes on from a checkpoint writes some rows again.
        self._run.define_metric("*", step_metric="step")

    def log(self, row: Mapping[str, Any]) -> None:
        self._run.log(dict(row))

    def close(self) -> None:
        self._run.finish()


_KINDS: dict[str, Callable[[Path, TrainConfig, int], Logger]] = {
    "tensorboard": _TensorBoard, "wandb": _Wandb
}  # fmt: skip
