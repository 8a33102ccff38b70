"""Files that appear under their name when they are whole, and never in another's place.

Every writer has a part of its own beside the file, so writers of one file do not meet: the last one
to finish wins, and a reader sees one whole file or another. Where files must agree, their writers
take turns (`jaxcam.files.locks`).
"""

import contextlib
import os
import shutil
import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path

from jaxcam.errors import ConfigError

MARK = "Written by jaxcam"
"""In every page of ours, which may be written anew."""
FOOTER = 1000
"""Bytes at the end of a page in which it stands."""


@contextlib.contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """Lets a file, or a folder, be written beside its place, which it takes when all is there.

    Args:
        path: Its place; folders above it are made.

    Yields:
        Where to write, a path of the same ending, at which nothing is. After an error, what is
        there is removed, and what the place had stays.

    Raises:
        ConfigError: The place has something that is no file, such as a device.
    """
    path = Path(path)
    if not _may_be_written(path):
        raise ConfigError(f"{path} is there, and is no file. Choose another place.")
    path.parent.mkdir(parents=True, exist_ok=True)
    token = uuid.uuid4().hex[:12]
    part = path.with_name(f".{path.stem[:40]}.{token}.part{path.suffix[:40]}")
    try:
        yield part
        os.replace(part, path)
    except BaseException as error:
        if isinstance(error, OSError) and error.filename is None:  # as of a full disk
            error.filename = str(path)
        if part.is_dir():
            shutil.rmtree(part, ignore_errors=True)
        part.unlink(missing_ok=True)
        raise


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


def check_free(path: Path, inputs: Iterator[Path] | tuple[Path, ...] = ()) -> None:
    """Refuse a place for a page that has something else: an input, or what we did not write.

    Args:
        path: Where the page is to go.
        inputs: What is read to make it.

    Raises:
        ConfigError: It may not be written; the message says why.
    """
    for given in inputs:
        if path.exists() and given.exists() and path.samefile(given):
            raise ConfigError(f"{path} is read here, so it is not written. Choose another --out.")
    if not path.exists():
        return
    if not path.is_file():
        raise ConfigError(f"{path} is there, and is no file. Choose another --out.")
    if not _is_ours(path):
        raise ConfigError(
            f"{path} is there, and jaxcam did not write it. Choose another --out, or move it away."
        )


def _is_ours(page: Path) -> bool:
    """Whether the last lines of a page say that jaxcam wrote it."""
    with open(page, "rb") as file:
        file.seek(max(0, page.stat().st_size - FOOTER))
        return MARK.encode() in file.read(FOOTER)


def _may_be_written(path: Path) -> bool:
    return path.is_file() or path.is_symlink() or not path.exists()
