"""Paths as people give them."""

import errno
import os
from pathlib import Path


def home(path: str | Path) -> Path:
    """The path with the user's home for `~`; one of a user whom nobody knows stays as it is."""
    return Path(os.path.expanduser(path))  # that of Path raises for such users


def absolute(path: str | Path) -> Path:
    """The absolute path of one that was given to a command or a function.

    A relative path starts at the working directory, and `~` is the user's home, also where no shell
    has replaced it (`--data-dir=~/data`). Links are kept, so that a folder keeps the name that it
    was given by, but where `..` must know what they lead to.
    """
    given = home(path).absolute()
    return given.resolve() if ".." in given.parts else given


def inside(file: Path, folder: Path) -> bool:
    """Whether a file lies in a folder in truth: links in the folder that lead out of it do not."""
    return file.resolve().is_relative_to(folder.resolve())


def read_text(path: Path) -> str:
    """The text of a regular file.

    Args:
        path: Of the file.

    Raises:
        OSError: There is none that can be read; a device or a pipe, which may never end, is none.
        ValueError: It is not UTF-8.
    """
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    return path.read_text("utf-8")
