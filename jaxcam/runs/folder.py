"""A run's folder: its lock, its configuration and its records.

Only one process writes to a run folder, and only with the configuration the folder was made with.
"""

import datetime
import logging
import os
import shlex
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from jaxcam.config.fields import to_json
from jaxcam.config.train import TrainConfig
from jaxcam.errors import CheckpointError, ConfigError
from jaxcam.files.jsonl import append_jsonl, line_of
from jaxcam.files.locks import InUseError, NamedLock
from jaxcam.files.paths import absolute, regular
from jaxcam.files.whole import write_atomically
from jaxcam.runs.environment import record_environment
from jaxcam.runs.identity import differences, read_config
from jaxcam.runs.metrics import read_metrics

MIN_FREE = 500_000_000
"""Bytes that must be free before a run starts."""

WRITTEN = (
    "checkpoints", "metrics.jsonl", "command.txt", "env.txt", "git.txt", "weights.json", "damaged",
    "report.html", "diverged.npz", "eval", "plots", "pictures", "videos", "interface.json",
)  # fmt: skip
"""What a run writes into its folder beside its config.json, which comes first."""

_log = logging.getLogger(__name__)


class RunDir:
    """A run folder this process may write to. Make one with `RunDir.open`; close it when done."""

    def __init__(self, path: Path, lock: NamedLock) -> None:
        self.path = path
        self._lock = lock

    @classmethod
    def open(
        cls,
        config: TrainConfig,
        *,
        command: Sequence[str] | None = None,
        min_free: int = MIN_FREE,
    ) -> Self:
        """Make the run folder, or open the one that is there, and lock it.

        Args:
            config: Resolved settings; `config.run_dir` is the folder.
            command: The command line; None is this process's.
            min_free: Bytes that must be free.

        Raises:
            ConfigError: The folder cannot be written, has no space, is in use, or is of a run with
                another configuration. It is then left as it was.
        """
        path = absolute(config.run_dir)
        _check_writable(path, min_free)
        run = cls(path, _locked(path))
        try:
            run._adopt(config, list(sys.orig_argv if command is None else command))
        except BaseException:
            run.close()
            raise
        return run

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def close(self) -> None:
        """Let other processes have the folder."""
        self._lock.free()

    @property
    def checkpoints(self) -> Path:
        """Folder of the checkpoints."""
        return self.path / "checkpoints"

    @property
    def metrics(self) -> Path:
        """File of the metrics, one row a line."""
        return self.path / "metrics.jsonl"

    def check_there(self) -> None:
        """Make sure that the folder has not been renamed, moved or deleted.

        Raises:
            CheckpointError: It has.
        """
        if not (self.path / "config.json").is_file():
            raise CheckpointError(
                f"{self.path} was renamed, moved or deleted while its run trains, so nothing more "
                "can be saved there. Its checkpoints are whole, wherever they are now: move it "
                "back, or give its new place as --run-dir, and run the same command again."
            )

    def log(self, row: Mapping[str, Any]) -> None:
        """Append a row to the metrics."""
        append_jsonl(self.metrics, row)

    def rewind(self, step: int) -> None:
        """Drop metrics of later steps, which a run resumed at `step` writes again."""
        rows = read_metrics(self.path)
        kept = [row for row in rows if row["step"] <= step]
        if len(kept) < len(rows):
            write_atomically(self.metrics, "".join(line_of(row) for row in kept))

    def _adopt(self, config: TrainConfig, command: list[str]) -> None:
        """Compare with the configuration in the folder, then write down this start."""
        stored = self.path / "config.json"
        if stored.exists():
            self._compare(read_config(self.path), config)
        elif there := sorted(name for name in WRITTEN if (self.path / name).exists()):
            raise ConfigError(
                f"{self.path} has {', '.join(there)} but no config.json, so it is no run that can "
                "be continued. Choose another --run-dir."
            )
        write_atomically(stored, to_json(config))
        now = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
        commands = self.path / "command.txt"
        with open(regular(commands), "a", encoding="utf-8", errors="surrogateescape") as file:
            file.write(f"{now}  {shlex.join(command)}\n")
        record_environment(self.path)

    def _compare(self, old: TrainConfig, new: TrainConfig) -> None:
        changes = [d for d in differences(old, new) if d.field != "run_dir"]
        if refused := [str(d) for d in changes if d.changes_program]:
            listed = "\n  ".join(refused)
            raise ConfigError(
                f"{self.path} is of a run with another configuration:\n  {listed}\n"
                "Repeat the run's own settings to continue it, or choose another --run-dir."
            )
        for change in changes:
            _log.warning("Changed since the run began: %s.", change)


def holder(path: Path) -> str:
    """Who trains the run in a folder, "pid 7 on host since …"; empty if nobody does."""
    return NamedLock(path / "lock").held_by()


def _check_writable(path: Path, min_free: int) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe = path / f".probe-{os.getpid()}"
        probe.write_bytes(b"probe")
        probe.unlink()
        free = shutil.disk_usage(path).free
    except OSError as error:
        raise ConfigError(
            f"Cannot write to the run folder {path}: {error.strerror}. Choose another --run-dir, "
            "or make room or get permission."
        ) from error
    if free < min_free:
        raise ConfigError(
            f"No space for a run in {path}: {min_free / 1e6:.0f} MB needed, {free / 1e6:.0f} MB "
            "free. Make room or choose another --run-dir."
        )


def _locked(path: Path) -> NamedLock:
    """The folder's lock, taken for as long as this process lives."""
    lock = NamedLock(path / "lock")
    try:
        before = lock.take()
    except InUseError as error:
        raise ConfigError(
            f"The run folder {path} is in use by {error.holder or 'a process just starting'}. "
            "Wait for it, stop it, or choose another --run-dir."
        ) from error
    except OSError as error:
        raise ConfigError(f"Cannot lock {path / 'lock'}: {error.strerror}.") from error
    if before:
        _log.warning("The run in %s ended without closing it (%s); continuing.", path, before)
    return lock
