"""Files that appear under their name when they are whole, and never in another's place.

Every writer has a part of its own beside the file, so writers of one file do not meet: the last one
to finish wins, and a reader sees one whole file or another. Where files must agree, their writers
take turns (`jaxcam.files.locks`). A writer holds a lock on its part, which the kernel frees when it
ends: parts of writers that were killed are removed by the next one, those of others stay.
"""

import contextlib
import errno
import fcntl
import logging
import os
import re
import shutil
import tempfile
import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path

from jaxcam.errors import ConfigError

_log = logging.getLogger(__name__)

MARK = "Written by jaxcam"
"""In every page of ours, which may be written anew."""
FOOTER = 1000
"""Bytes at the end of a page in which it stands."""


@contextlib.contextmanager
def whole(path: str | Path, *, folder: bool = False) -> Iterator[Path]:
    """Lets a file, or a folder, be written beside its place, which it takes when all is there.

    Args:
        path: Its place; folders above it are made.
        folder: Whether it is a folder, which then must not be there.

    Yields:
        Where to write, a path of the same ending: an empty file or folder. After an error, what is
        there is removed, and what the place had stays.

    Raises:
        ConfigError: The place has something that is no file, such as a device.
    """
    path = Path(path)
    if not _may_be_written(path) or (folder and path.exists()):
        raise ConfigError(f"{path} is there, and is no file. Choose another place.")
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_dead_parts(path)
    part, descriptor = _new_part(path, folder)
    try:
        yield part
        _take_place(part, path)
    except BaseException as error:
        if isinstance(error, OSError) and error.filename is None:  # as of a full disk
            error.filename = str(path)
        _remove(part)
        raise
    finally:
        os.close(descriptor)


def write_atomically(path: Path, text: str) -> None:
    """Write a file so that a crash leaves the old content or the new, never a part."""
    write_together({path: text})


def write_together(texts: Mapping[Path, str]) -> None:
    """Write files that belong to each other, each as `write_atomically` does.

    All are on the disk before the first takes its place, so that a crash hardly ever, and a full
    disk never, leaves some of them old and some new.

    Args:
        texts: Their content.
    """
    with contextlib.ExitStack() as places:
        for path, text in texts.items():
            part = places.enter_context(whole(path))
            with open(part, "w", encoding="utf-8", errors="surrogateescape") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())


def check_free(
    path: Path,
    inputs: Iterator[Path] | tuple[Path, ...] = (),
    flag: str = "--out",
    *,
    writable: bool = True,
) -> None:
    """Refuse a place for a page that cannot be written, or has an input or what we did not write.

    Args:
        path: Where the page is to go.
        inputs: What is read to make it.
        flag: That named the place.
        writable: Whether it must be possible to write there; else the page alone is lost.

    Raises:
        ConfigError: It may not be written; the message says why.
    """
    for given in inputs:
        if path.exists() and given.exists() and path.samefile(given):
            raise ConfigError(f"{path} is read here, so it is not written. Choose another {flag}.")
    if writable:
        _check_writable(path, flag)
    if not path.exists():
        return
    if not path.is_file():
        raise ConfigError(f"{path} is there, and is no file. Choose another {flag}.")
    if not _is_ours(path):
        raise ConfigError(
            f"{path} is there, and jaxcam did not write it. Choose another {flag}, or move it away."
        )


def _check_writable(path: Path, flag: str) -> None:
    """Tries to write beside a place, or in the first folder above it that is there."""
    place = path.absolute()
    folder = next(above for above in (*place.parents, place) if above.exists())
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise ConfigError(
            f"{path} cannot be written: {folder}: {reason}. Choose another {flag}."
        ) from error


def _take_place(part: Path, path: Path) -> None:
    try:
        os.replace(part, path)
    except OSError as error:
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
            raise
        raise ConfigError(f"{path} is there by now. Choose another place.") from error


def _new_part(path: Path, folder: bool) -> tuple[Path, int]:
    """An empty file or folder beside a place, and an open descriptor that has it locked."""
    while True:
        part = path.with_name(f".{path.stem[:30]}.{uuid.uuid4().hex[:12]}.part{path.suffix[:20]}")
        if folder:
            part.mkdir()
        flags = os.O_RDONLY if folder else os.O_RDWR | os.O_CREAT | os.O_EXCL
        descriptor = os.open(part, flags, 0o666)
        with contextlib.suppress(OSError):  # where there are no locks, nothing is removed either
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        if part.exists():  # else it was taken for a dead one before it was locked
            return part, descriptor
        os.close(descriptor)


def _remove_dead_parts(path: Path) -> None:
    """Removes parts of a place whose writers ended before they were whole."""
    before, after = re.escape(f".{path.stem[:30]}."), re.escape(f".part{path.suffix[:20]}")
    pattern = re.compile(f"{before}[0-9a-f]{{12}}{after}")
    names: list[str] = []
    with contextlib.suppress(OSError):  # of a folder that can be written to but not be listed
        names = [name for name in os.listdir(path.parent) if pattern.fullmatch(name)]
    for part in map(path.with_name, names):
        with contextlib.suppress(OSError):
            flags = os.O_RDONLY if part.is_dir() else os.O_RDWR
            descriptor = os.open(part, flags | os.O_NOFOLLOW | os.O_NONBLOCK)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                _remove(part)
                _log.warning("Removed %s, which a writer that was killed has left.", part)
            finally:
                os.close(descriptor)


def _remove(part: Path) -> None:
    if part.is_dir():
        shutil.rmtree(part, ignore_errors=True)
    else:
        part.unlink(missing_ok=True)


def _is_ours(page: Path) -> bool:
    """Whether the last lines of a page say that jaxcam wrote it."""
    with open(page, "rb") as file:
        file.seek(max(0, page.stat().st_size - FOOTER))
        return MARK.encode() in file.read(FOOTER)


def _may_be_written(path: Path) -> bool:
    return path.is_file() or path.is_symlink() or not path.exists()
