"""Locks between processes that make the same file."""

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from rich.console import Console

from jaxcam.errors import DatasetError


@contextlib.contextmanager
def exclusive(path: Path, console: Console | None = None) -> Iterator[None]:
    """Lets one process at a time in; the others wait, then find what the first one made.

    The kernel frees the lock when its holder ends, even by `kill -9`.

    Args:
        path: what is to be made; the lock is `<path>.lock` beside it and stays there, empty.
        console: where to say that another process is waited for.

    Raises:
        DatasetError: if the folder cannot be written to.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(f"{path}.lock", os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise DatasetError(
            f"Cannot write to {path.parent}: {error.strerror}. Choose another --data-dir, or make "
            "room or get permission."
        ) from error
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if console:
                console.print(f"Waiting for the process that is making {path.name}.")
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
