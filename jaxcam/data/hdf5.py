"""Opening HDF5 files that may be anything: whose layout they have, and what is wrong with them."""

import contextlib
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import h5py

from jaxcam.errors import DatasetError, JaxcamError

Format = Literal["jaxcam", "robomimic", "robosuite", "maniskill", "unknown"]
"""Whose layout a file of demonstrations has."""
_SIGNATURE = b"\x89HDF\r\n\x1a\n"


def require_file(path: Path, missing: str = "no such file.") -> None:
    """Refuses a path that does not lead to a regular file with something in it.

    What is neither a file nor a folder must not be opened: a pipe waits, a device never ends.

    Args:
        path: Of the file.
        missing: What the message says where there is nothing.

    Raises:
        DatasetError: Naming what is there instead.
    """
    try:
        found = path.stat()
    except (FileNotFoundError, NotADirectoryError) as error:
        raise DatasetError(f"{path}: {missing}") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise DatasetError(f"{path}: cannot be opened: {reason}.") from error
    if stat.S_ISDIR(found.st_mode):
        raise DatasetError(f"{path}: a folder; expected a file.")
    if not stat.S_ISREG(found.st_mode):
        raise DatasetError(f"{path}: a pipe, socket or device; expected a file.")
    if not found.st_size:
        raise DatasetError(f"{path}: an empty file (0 bytes). Copy or make it anew.")


def open_hdf5(path: Path, *, missing: str = "no such file.", remedy: str) -> h5py.File:
    """Opens an HDF5 file for reading.

    Args:
        path: Of the file.
        missing: What the message says where there is none.
        remedy: What to do with a damaged one, a sentence.

    Raises:
        DatasetError: It is no file, cannot be read, or is not HDF5 or damaged.
    """
    require_file(path, missing)
    with whole(path, remedy):
        return h5py.File(path, "r")


@contextlib.contextmanager
def whole(path: Path, remedy: str) -> Iterator[None]:
    """Turns what HDF5's library raises on damage into one error; for all that reads a file.

    Args:
        path: Of the file that is read.
        remedy: What to do with a damaged one, a sentence.

    Raises:
        DatasetError: The file is not HDF5, or damaged.
    """
    try:
        yield
    except JaxcamError:
        raise
    except PermissionError as error:
        raise DatasetError(f"{path}: no permission to read it.") from error
    except (OSError, RuntimeError, LookupError, TypeError, ValueError) as error:
        # HDF5's library reports damage in all of these ways.
        with path.open("rb") as file:
            head = file.read(len(_SIGNATURE))
        if head != _SIGNATURE:
            raise DatasetError(f"{path}: not an HDF5 file; it starts with {head!r}.") from error
        raise DatasetError(
            f"{path}: damaged or truncated ({path.stat().st_size} bytes; {error}). {remedy}"
        ) from error


def format_of(file: h5py.File) -> Format:
    """Whose layout an open file has, by its groups and attributes."""
    if "data" not in file:
        is_trajectories = any(re.fullmatch(r"traj_\d+", str(name)) for name in file)
        return "maniskill" if is_trajectories else "unknown"
    attributes: Any = file["data"].attrs
    if "jaxcam" in attributes:
        return "jaxcam"
    if "env_args" in attributes:
        return "robomimic"
    return "robosuite" if "env" in attributes else "unknown"
