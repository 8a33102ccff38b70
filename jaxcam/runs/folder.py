"""A run's folder: its lock, its configuration, its records, and how a run is stopped.

Only one process writes to a run folder, and only with the configuration the folder was made with.
"""

import datetime
import fcntl
import logging
import os
import shlex
import shutil
import socket
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from jaxcam.config.fields import from_json, to_json
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.files.jsonl import append_jsonl, line_of, read_jsonl, write_atomically
from jaxcam.files.paths import absolute
from jaxcam.runs.environment import environment, git_revision
from jaxcam.runs.identity import differences, resolve

MIN_FREE = 500_000_000
"""Bytes that must be free before a run starts."""

_log = logging.getLogger(__name__)


class RunDir:
    """A run folder this process may write to. Make one with `RunDir.open`; close it when done."""

    def __init__(self, path: Path, lock: int) -> None:
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
        run = cls(path, _lock(path / "lock"))
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
        if self._lock >= 0:
            os.truncate(self.path / "lock", 0)
            os.close(self._lock)  # Closing releases the lock.
            self._lock = -1

    @property
    def checkpoints(self) -> Path:
        """Folder of the checkpoints."""
        return self.path / "checkpoints"

    @property
    def metrics(self) -> Path:
        """File of the metrics, one row a line."""
        return self.path / "metrics.jsonl"

    def log(self, row: Mapping[str, Any]) -> None:
        """Append a row to the metrics."""
        append_jsonl(self.metrics, row)

    def rewind(self, step: int) -> None:
        """Drop metrics of later steps, which a run resumed at `step` writes again."""
        rows = read_jsonl(self.metrics)
        kept = [row for row in rows if row.get("step", 0) <= step]
        if len(kept) < len(rows):
            write_atomically(self.metrics, "".join(line_of(row) for row in kept))

    def _adopt(self, config: TrainConfig, command: list[str]) -> None:
        """Compare with the configuration in the folder, then write down this start."""
        stored = self.path / "config.json"
        if stored.exists():
            old = from_json(TrainConfig, stored.read_text("utf-8"))
            # Settings that are newer than the run: it was made with their preset's values.
            self._compare(resolve(old, accelerator=False), config)
        elif self.checkpoints.exists() and any(self.checkpoints.iterdir()):
            raise ConfigError(
                f"{self.path} has checkpoints but no config.json, so it cannot be continued. "
                "Choose another --run-dir."
            )
        write_atomically(stored, to_json(config))
        now = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
        with open(self.path / "command.txt", "a", encoding="utf-8") as file:
            file.write(f"{now}  {shlex.join(command)}\n")
        self._write_environment()
        if revision := git_revision():
            write_atomically(self.path / "git.txt", revision)

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

    def _write_environment(self) -> None:
        file = self.path / "env.txt"
        text = "".join(f"{name} {value}\n" for name, value in environment().items())
        if file.exists() and file.read_text("utf-8") != text:
            old = set(file.read_text("utf-8").splitlines())
            new = [line for line in text.splitlines() if line not in old]
            _log.warning("The environment changed, so results are not bit-exact: now %s.",
                         ", ".join(new) or "fewer packages")  # fmt: skip
        write_atomically(file, text)


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


def _lock(path: Path) -> int:
    """Lock a file for as long as this process lives; the kernel frees it even after kill -9."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        holder = os.pread(descriptor, 1000, 0).decode(errors="replace").strip()
        os.close(descriptor)
        if not isinstance(error, BlockingIOError):
            raise ConfigError(f"Cannot lock {path}: {error.strerror}.") from error
        raise ConfigError(
            f"The run folder {path.parent} is in use by {holder or 'a process just starting'}. "
            "Wait for it, stop it, or choose another --run-dir."
        ) from error
    if left := os.pread(descriptor, 1000, 0).decode(errors="replace").strip():
        _log.warning("The run in %s ended without closing it (%s); continuing.", path.parent, left)
    now = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, f"pid {os.getpid()} on {socket.gethostname()} since {now}\n".encode(), 0)
    return descriptor
