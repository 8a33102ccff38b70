"""Paths as people give them."""

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
