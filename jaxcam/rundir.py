"""A run's folder: its lock, its configuration, its records, and how a run is stopped.

Only one process writes to a run folder, and only with the configuration the folder was made with.
"""

import contextlib
import datetime
import fcntl
import importlib.metadata
import json
import logging
import os
import platform
import shlex
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, Self

from jaxcam.config import TrainConfig, differences, resolve
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.fields import from_json, to_json

PACKAGES = ("jaxcam", "jax", "jaxlib", "flax", "optax", "orbax-checkpoint", "numpy", "mujoco",
            "mujoco-mjx", "warp-lang", "robosuite")  # fmt: skip

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
        path = Path(config.run_dir).absolute()
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
            write_atomically(self.metrics, "".join(_line(row) for row in kept))

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


class Interrupt:
    """Whether the user or the cluster asked the run to stop."""

    def __init__(self) -> None:
        self.signal: signal.Signals | None = None

    def __bool__(self) -> bool:
        return self.signal is not None

    @property
    def exit_code(self) -> int:
        """What a shell expects of a process that stopped for this signal: 130 or 143."""
        return 128 + self.signal if self.signal is not None else 0


@contextlib.contextmanager
def interrupts() -> Iterator[Interrupt]:
    """Turn the first SIGINT or SIGTERM into a flag; the second ends the process at once.

    Yields:
        The flag, false until a signal arrives. The trainer looks at it between updates, saves,
        and says how to go on.
    """
    interrupt = Interrupt()

    def handle(number: int, frame: FrameType | None) -> None:
        if interrupt:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
        interrupt.signal = signal.Signals(number)
        # Not print: a signal may arrive inside one, and buffered files refuse to be re-entered.
        os.write(2, b"\nStopping after this update; once more stops now, without saving.\n")

    before = {s: signal.signal(s, handle) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield interrupt
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def append_jsonl(path: str | Path, *rows: Mapping[str, Any], fsync: bool = False) -> None:
    """Append rows to a file of JSON lines, in one write.

    A last line that a crash left torn is cut off first.

    Args:
        path: File; made if missing.
        rows: Rows; NumPy and JAX numbers in them become plain ones.
        fsync: Whether to wait until the rows are on the disk.
    """
    data = "".join(_line(row) for row in rows).encode()
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
    with open(descriptor, "r+b", buffering=0) as file:
        _cut_torn_line(file)
        while data:  # A nearly full disk takes a part, then raises on the next write.
            data = data[file.write(data) :]
        if fsync:
            os.fsync(file.fileno())


def read_jsonl(path: str | Path) -> list[dict[str, Any]]:
    """Rows of a file of JSON lines; none if it is missing. A torn last line is left out.

    Raises:
        DatasetError: A line before the last one is damaged.
    """
    path = Path(path)
    if not path.exists():
        return []
    rows = []
    whole, _, _ = path.read_bytes().rpartition(b"\n")
    for number, line in enumerate(whole.splitlines(), start=1):
        try:
            row = json.loads(line)
        except ValueError as error:
            raise DatasetError(f"{path}, line {number}, is damaged: {line[:80]!r}.") from error
        rows.append(row)
    return rows


def write_atomically(path: Path, text: str) -> None:
    """Write a file so that a crash leaves the old content or the new, never a part."""
    part = path.with_name(path.name + ".part")
    with open(part, "w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)


def package_versions() -> dict[str, str]:
    """Versions of the packages that can change results; those not installed are left out."""
    versions = {}
    for name in PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            versions[name] = importlib.metadata.version(name)
    return versions


def environment() -> dict[str, str]:
    """Packages, Python, system and devices, for the records of a run."""
    import jax

    devices = ", ".join(f"{d.platform} {d.device_kind}" for d in jax.devices())
    system = {"python": platform.python_version(), "system": platform.platform()}
    return {**package_versions(), **system, "cores": str(os.cpu_count()), "devices": devices}


def git_revision() -> str | None:
    """Commit and uncommitted changes of the checkout jaxcam runs from, or None if it is none."""
    here = Path(__file__)

    def git(*args: str) -> str:
        command = ["git", "-C", str(here.parent), *args]
        return subprocess.run(
            command, capture_output=True, text=True, check=True, timeout=10
        ).stdout

    try:
        git("ls-files", "--error-unmatch", here.name)  # Else the checkout is someone else's.
        return git("rev-parse", "HEAD") + git("status", "--porcelain") + git("diff", "HEAD")
    except (OSError, subprocess.SubprocessError):
        return None


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


def _cut_torn_line(file: Any) -> None:
    """Cut what follows the last line end, looking back block by block."""
    end = keep = file.seek(0, os.SEEK_END)
    while keep:
        start = max(0, keep - 65536)
        file.seek(start)
        block = file.read(keep - start)
        if (found := block.rfind(b"\n")) >= 0:
            keep = start + found + 1
            break
        keep = start
    if keep < end:
        file.truncate(keep)


def _line(row: Mapping[str, Any]) -> str:
    return json.dumps(row, default=lambda x: x.tolist()) + "\n"
