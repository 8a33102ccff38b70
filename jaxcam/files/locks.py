"""Locks between processes: one to wait for, and one that says who holds it.

The kernel frees a lock when its holder ends, even by `kill -9`. The lock's file stays.
"""

import contextlib
import datetime
import errno
import fcntl
import os
import socket
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout
from rich.console import Console

from jaxcam.errors import DatasetError, JaxcamError
from jaxcam.files.paths import regular
from jaxcam.interrupts import check_stop


@contextlib.contextmanager
def exclusive(path: Path, console: Console | None = None) -> Iterator[None]:
    """Lets one process at a time in; the others wait, then find what the first one made.

    Args:
        path: What is to be made; the lock is `<path>.lock` beside it, an empty file.
        console: Where to say that another process is waited for.

    Raises:
        DatasetError: The folder cannot be written to.
    """
    lock = _lock(Path(f"{path}.lock"))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            lock.acquire(blocking=False)
        except Timeout:
            if console:
                console.print(f"Waiting for the process that is making {path.name}.")
            while not _acquired(lock):
                check_stop()
    except OSError as error:
        raise DatasetError(
            f"Cannot write to {path.parent}: {error.strerror}. Get permission, make room, or "
            "choose another place."
        ) from error
    try:
        yield
    finally:
        lock.release()


class InUseError(JaxcamError):
    """Another process holds a lock.

    Attributes:
        holder: What it says of itself, "pid 7 on host since …"; empty while it is just starting.
    """

    def __init__(self, path: Path, holder: str) -> None:
        super().__init__(f"{path} is held by {holder or 'a process just starting'}.")
        self.holder = holder


class NamedLock:
    """A lock whose file says who holds it.

    Args:
        path: Its file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = _lock(path)

    def take(self) -> str:
        """Take it, or fail at once.

        Returns:
            What a holder that ended without freeing it said of itself; empty if none did.

        Raises:
            InUseError: Another holds it.
            OSError: The file cannot be made or locked, or is something else than a lock.
        """
        try:
            self._lock.acquire(blocking=False)
        except Timeout as error:
            raise InUseError(self._path, self._holder()) from error
        now = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
        try:
            before = self._holder()
            if before and not before.startswith("pid "):
                raise OSError(errno.EEXIST, "a file that is no lock of ours", str(self._path))
            me = f"pid {os.getpid()} on {socket.gethostname()} since {now}\n"
            self._path.write_text(me, "utf-8")
        except OSError:
            self._lock.release()
            raise
        return before

    def held_by(self) -> str:
        """What its holder says of itself; empty if nobody holds it. The lock stays as it is."""
        try:
            with open(regular(self._path), "rb") as file:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return self._holder() or "a process just starting"
        except OSError:
            return ""
        return ""

    def free(self) -> None:
        """Let others take it; nothing if it is free."""
        if self._lock.is_locked:
            with contextlib.suppress(FileNotFoundError):  # its folder may have been moved away
                os.truncate(self._path, 0)
            self._lock.release()

    def _holder(self) -> str:
        with open(regular(self._path), "rb") as file:
            return file.read(1000).decode(errors="replace").strip()


def _acquired(lock: FileLock) -> bool:
    """Whether the lock could be taken within half a second."""
    try:
        lock.acquire(timeout=0.5)
    except Timeout:
        return False
    return True


def _lock(path: Path) -> FileLock:
    # Where the file system has no locks, one made of a file's existence would outlive its holder.
    return FileLock(path, thread_local=False, fallback_to_soft=False)
