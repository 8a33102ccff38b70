"""Paths as people give them."""

import errno
import os
from pathlib import Path

from jaxcam.errors import ConfigError


def home(path: str | Path) -> Path:
    """The path with the user's home for `~`; one of a user whom nobody knows stays as it is.

    Raises:
        ConfigError: It is empty, as a variable of a shell is that was never set: nobody who gives
            that means the working directory.
    """
    if path == "":
        raise ConfigError("A path is empty. Name a file or a folder; the one you are in is '.'.")
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


LARGEST_TEXT = 1 << 25
"""Bytes of a text that is read whole: what JSON says takes up to twenty times its size."""


def regular(path: Path) -> Path:
    """The path, unless something is there that is no file: a device or a pipe may never end.

    Raises:
        OSError: It is such a thing, or leads to itself.
    """
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    return path


def read_bytes(path: Path, most: int = LARGEST_TEXT) -> bytes:
    """The content of a regular file.

    Args:
        path: Of the file.
        most: Bytes that it can have.

    Raises:
        OSError: There is none that can be read, or it is larger.
    """
    with open(regular(path), "rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        size = path.stat().st_size
        words = f"{size / 1e6:.0f} MB, but such a file has {most / 1e6:.0f} MB at most"
        raise OSError(errno.EINVAL, words, str(path))
    return content


def read_text(path: Path, errors: str = "strict") -> str:
    """The text of a regular file, see `read_bytes`.

    Args:
        path: Of the file.
        errors: What becomes of bytes that are no UTF-8, as `bytes.decode` has it.

    Raises:
        OSError: There is none that can be read.
        ValueError: It is not UTF-8.
    """
    return read_bytes(path).decode("utf-8", errors)
