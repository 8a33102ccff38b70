"""Demonstrations in whatever format they come, and which that is."""

import os
from pathlib import Path
from typing import Literal

from rich.console import Console

from jaxcam.config.datasets import ManiskillConfig, RobomimicConfig
from jaxcam.data.demos import REMEDY, Demos, read_demos
from jaxcam.data.hdf5 import Format, format_of, open_hdf5, reading
from jaxcam.errors import DatasetError
from jaxcam.interop import maniskill, robomimic
from jaxcam.interop.droid.reading import is_droid

FolderFormat = Literal["lerobot", "droid"]
"""Whose layout a folder of recorded demonstrations has."""


def recognise(path: Path) -> Format | FolderFormat:
    """Whose layout a file or folder has; "unknown" too if it cannot be opened: `read` says why."""
    if os.path.isdir(path):  # that of Path raises for names that are too long
        if (path / "meta" / "info.json").is_file():
            return "lerobot"
        return "droid" if is_droid(path) else "unknown"
    try:
        with open_hdf5(path, remedy=REMEDY) as file, reading(path, REMEDY):
            return format_of(file)
    except DatasetError:
        return "unknown"


def read(path: Path, out: Path | None = None, console: Console | None = None) -> Demos:
    """Demonstrations of a file; those of others become a dataset of ours, with the usual settings.

    Args:
        path: Of the file.
        out: Dataset that others' demonstrations are written to; None is the importers' own choice.
        console: For progress; silent when None.

    Raises:
        DatasetError: It cannot be opened, is damaged, in no format that is known, or cannot be
            replayed in our tasks; or the dataset exists.
        SimError: This machine cannot run the simulator that an import needs.
    """
    written = str(out) if out else None
    match recognise(path):
        case "maniskill":
            theirs = ManiskillConfig(str(path), out=written)
            return maniskill.import_trajectories(theirs, console).demos
        case "robomimic":
            theirs = RobomimicConfig(str(path), task=robomimic.task_of(path), out=written)
            return robomimic.import_demos(theirs, console)
    return read_demos(path)
