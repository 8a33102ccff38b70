"""Opening and reading HDF5 files that may be anything: whose they are, and what is wrong with them.

A file may come from anybody, so nothing outside it is read, whatever it links to, and no array is
read before its own counts say that it is of a size that demonstrations have.
"""

import contextlib
import math
import re
import stat
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np

from jaxcam.errors import DatasetError, JaxcamError

Format = Literal["jaxcam", "robomimic", "robosuite", "maniskill", "unknown"]
"""Whose layout a file of demonstrations has."""
LARGEST_ARRAY = 1 << 26
"""Bytes of one array that is read. An hour of control steps of 100 numbers has 58 MB."""
LARGEST_NAME = 256
"""Characters of a name in a list of names."""
LARGEST_TEXT = 1 << 24
"""Characters of an attribute: a MuJoCo model in full has 40 thousand."""
EXPANDS = 20
"""How many times its own size a file of ours may have when it is read: our files do not compress,
and what others make of them (`h5repack`) shrinks to a third."""
CHECKSUM = 4
"""Bytes that a checksum adds to a chunk."""
FREE = 1 << 26
"""Bytes that any file may declare."""
_LOW: Any = h5py  # its modules for single calls of HDF5 have no types
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_UNKNOWN_NAME = re.compile(r"(?:object|attribute:) '([^']+)'(?: doesn't exist|\))")


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
        status = path.stat()
    except (FileNotFoundError, NotADirectoryError) as error:
        raise DatasetError(f"{path}: {missing}") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise DatasetError(f"{path}: cannot be opened: {reason}.") from error
    if stat.S_ISDIR(status.st_mode):
        raise DatasetError(f"{path}: a folder; expected a file.")
    if not stat.S_ISREG(status.st_mode):
        raise DatasetError(f"{path}: a pipe, socket or device; expected a file.")
    if not status.st_size:
        raise DatasetError(f"{path}: an empty file (0 bytes). Copy or make it anew.")


def open_hdf5(path: Path, *, missing: str = "no such file.", remedy: str) -> h5py.File:
    """Opens an HDF5 file for reading, unless it points outside itself or declares giants.

    Args:
        path: Of the file.
        missing: What the message says where there is none.
        remedy: What to do with a damaged one, a sentence.

    Raises:
        DatasetError: It is no file, cannot be read, is not HDF5 or damaged, has parts in other
            files, or is of our layout and declares more than such a file can hold.
    """
    require_file(path, missing)
    with reading(path, remedy):
        file = h5py.File(path, "r")
        try:
            arrays = _check_parts(path, file)
            if format_of(file) == "jaxcam":  # all of it is read
                check_total(path, sum(_bytes_of(array) for array in arrays.values()))
                for name, array in arrays.items():
                    _check_chunks(array, f"{path}: {name}")
        except BaseException:
            file.close()
            raise
        return file


def _check_parts(path: Path, file: h5py.File) -> dict[str, h5py.h5d.DatasetID]:
    """Refuses links and arrays whose content lies in other files; all arrays by their name."""
    links: dict[bytes, int] = {}
    file.id.links.visit(lambda name, info: links.__setitem__(name, info.type), info=True)
    arrays = {}
    for name, kind in links.items():
        if kind not in (_LOW.h5l.TYPE_HARD, _LOW.h5l.TYPE_SOFT):
            raise _outside(path, name, "a link to another file")
        if kind == _LOW.h5l.TYPE_SOFT:
            continue  # what it leads to has its own, hard link, or is missing
        if _LOW.h5o.get_info(file.id, name).type != _LOW.h5o.TYPE_DATASET:
            continue
        array = h5py.h5d.open(file.id, name)
        made = array.get_create_plist()
        if made.get_layout() == h5py.h5d.VIRTUAL:
            raise _outside(path, name, "a virtual dataset, made of parts of other files")
        if made.get_external_count():
            raise _outside(path, name, "a dataset whose numbers lie in another file")
        arrays[name.decode(errors="replace")] = array
    return arrays


def _outside(path: Path, name: bytes, what: str) -> DatasetError:
    return DatasetError(
        f"{path}: {name.decode(errors='replace')} is {what}. Nothing outside the file is read: "
        "copy all of it into one file, for example with h5repack."
    )


def _bytes_of(array: h5py.h5d.DatasetID) -> int:
    """Bytes that an array declares, as numbers of 8 at least, or that one chunk of it takes."""
    made = array.get_create_plist()
    shape = array.get_space().shape
    elements = 0 if shape is None else math.prod(shape)
    if elements and made.get_layout() == h5py.h5d.CHUNKED:
        elements = max(elements, math.prod(made.get_chunk()))
    return elements * max(array.get_type().get_size(), 8)


def _check_chunks(array: h5py.h5d.DatasetID, where: str) -> None:
    """Refuses chunks that unpack to more than a chunk: HDF5 would take memory without end."""
    made = array.get_create_plist()
    if made.get_layout() != h5py.h5d.CHUNKED:
        return
    used = [made.get_filter(i)[0] for i in range(made.get_nfilters())]
    packed = [f for f in used if f not in (_LOW.h5z.FILTER_SHUFFLE, _LOW.h5z.FILTER_FLETCHER32)]
    if not packed:
        return
    if packed != [_LOW.h5z.FILTER_DEFLATE]:
        raise DatasetError(f"{where}: packed by HDF5's filters {packed}. Repack it with gzip.")
    size = math.prod(made.get_chunk()) * array.get_type().get_size() + CHECKSUM
    offsets: list[tuple[int, ...]] = []
    array.chunk_iter(lambda chunk: offsets.append(chunk.chunk_offset))
    for offset in offsets:
        skipped, stored = array.read_direct_chunk(offset)
        try:
            unpacked = b"" if skipped else zlib.decompressobj().decompress(stored, size + 1)
        except zlib.error:
            continue  # HDF5 finds the damage when it reads
        if len(unpacked) > size:
            raise DatasetError(f"{where}: a chunk declares {size} bytes, but unpacks to more.")


def check_total(path: Path, declared: int) -> None:
    """Refuses arrays that together are out of proportion to the file that they are in.

    Args:
        path: Of the file.
        declared: Bytes of all that will be read of it.

    Raises:
        DatasetError: They are.
    """
    size = path.stat().st_size
    if declared > FREE + EXPANDS * size:
        raise DatasetError(
            f"{path}: its arrays declare {declared / 1e6:.0f} MB, but the file has "
            f"{size / 1e6:.1f} MB. No file of demonstrations is like that: copy or make it anew."
        )


def group_at(group: h5py.Group, name: str) -> h5py.Group:
    """A group in a group.

    Raises:
        DatasetError: There is none, or something else.
    """
    item = group.get(name)
    if not isinstance(item, h5py.Group):
        raise _not_there(group, name, "group", item)
    return item


def array_at(group: h5py.Group, name: str) -> h5py.Dataset:
    """A dataset in a group, unread; of numbers or text, and of a size that can be read.

    Raises:
        DatasetError: There is none, something else, or it declares more than can be read.
    """
    item = group.get(name)
    if not isinstance(item, h5py.Dataset):
        raise _not_there(group, name, "dataset", item)
    if (size := _bytes_of(item.id)) > LARGEST_ARRAY:
        raise DatasetError(
            f"{_where(group, name)}: declares {size / 1e6:.0f} MB (shape {list(item.shape)}); at "
            f"most {LARGEST_ARRAY / 1e6:.0f} MB are read of one array."
        )
    _check_chunks(item.id, _where(group, name))
    return item


def numbers(group: h5py.Group, name: str) -> np.ndarray:
    """A dataset of real numbers, as float64.

    Raises:
        DatasetError: There is none, it is of another kind, or too large.
    """
    array = array_at(group, name)
    if array.dtype.kind not in "fiub" or array.shape is None:
        raise DatasetError(f"{_where(group, name)}: {array.dtype}; expected numbers.")
    return np.asarray(array[()], np.float64)


def names_at(group: h5py.Group, name: str, most: int) -> list[str]:
    """A dataset that lists names.

    Args:
        group: Where it is.
        name: Of the dataset.
        most: Names that there can be.

    Raises:
        DatasetError: There is none, or it is no list of names.
    """
    array = array_at(group, name)
    if array.dtype.kind not in "SO" or array.ndim != 1:
        raise DatasetError(
            f"{_where(group, name)}: {array.dtype} {list(array.shape or ())}; expected a list "
            "of names."
        )
    if len(array) > most:
        raise DatasetError(f"{_where(group, name)}: {len(array)} names, but only {most} exist.")
    listed = []
    for i in range(len(array)):  # one by one: all may be the same long text in the file
        entry = array[i]
        if not isinstance(entry, bytes | str) or len(entry) > LARGEST_NAME:
            raise DatasetError(f"{_where(group, name)}: entry {i} is no name.")
        listed.append(entry.decode("utf-8", "replace") if isinstance(entry, bytes) else entry)
    return listed


def text(group: h5py.Group, name: str) -> str:
    """An attribute that is text.

    Raises:
        DatasetError: There is none, or it is something else.
    """
    if name not in group.attrs:
        raise DatasetError(f"{_where(group)}: no attribute {name!r}.")
    about = group.attrs.get_id(name)
    kind = about.dtype.kind
    if about.shape != () or kind not in "SO":
        raise DatasetError(f"{_where(group)}: attribute {name!r} is no text.")
    value = group.attrs[name]
    if not isinstance(value, bytes | str) or len(value) > LARGEST_TEXT:
        raise DatasetError(f"{_where(group)}: attribute {name!r} is no text.")
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def _not_there(group: h5py.Group, name: str, kind: str, item: object) -> DatasetError:
    if item is None:
        return DatasetError(f"{_where(group)}: no {name!r}.")
    return DatasetError(f"{_where(group, name)}: no {kind}.")


def _where(group: h5py.Group, name: str = "") -> str:
    """File and place in it, as messages have them."""
    within = "/".join(part for part in (str(group.name).strip("/"), name) if part)
    return f"{group.file.filename}: {within}" if within else group.file.filename


@contextlib.contextmanager
def reading(path: Path, remedy: str, part: str = "") -> Iterator[None]:
    """Turns what HDF5's library raises on damage into one error; for all that reads a file.

    Args:
        path: Of the file that is read.
        remedy: What to do with a damaged one, a sentence.
        part: Of the file that is read.

    Raises:
        DatasetError: The file is not HDF5, or damaged.
    """
    try:
        yield
    except JaxcamError:
        raise
    except PermissionError as error:
        raise DatasetError(f"{path}: no permission to read it.") from error
    except (OSError, RuntimeError, LookupError, MemoryError, TypeError, ValueError) as error:
        # HDF5's library reports damage in all of these ways.
        with path.open("rb") as file:
            head = file.read(len(_SIGNATURE))
        if head != _SIGNATURE:
            raise DatasetError(f"{path}: not an HDF5 file; it starts with {head!r}.") from error
        where = f"{path}: {part}" if part else str(path)
        if unknown := _UNKNOWN_NAME.search(str(error)):
            raise DatasetError(f"{where}: no {unknown[1]!r} in it. {remedy}") from error
        raise DatasetError(
            f"{where}: damaged or truncated ({path.stat().st_size} bytes). {remedy}"
        ) from error


def format_of(file: h5py.File) -> Format:
    """Whose layout an open file has, by its groups and attributes."""
    if not isinstance(file.get("data"), h5py.Group):
        is_trajectories = any(re.fullmatch(r"traj_[0-9]+", str(name)) for name in file)
        return "maniskill" if is_trajectories else "unknown"
    attributes: Any = file["data"].attrs
    if "jaxcam" in attributes:
        return "jaxcam"
    if "env_args" in attributes:
        return "robomimic"
    return "robosuite" if "env" in attributes else "unknown"
