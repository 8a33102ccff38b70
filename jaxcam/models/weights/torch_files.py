"""Read PyTorch's `.pt` and `.pth` files without PyTorch, and without running what is in them.

Such a file is a pickle, which may call anything. The reader here knows the few names that tensors
and plain containers need and refuses every other one. Both layouts are read: the zip archive that
PyTorch writes since 1.6, and the row of pickles from before. What is read takes a small multiple of
the file's size, whatever the file asks for.
"""

import io
import math
import pickle
import pickletools
import re
import zipfile
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any

import ml_dtypes
import numpy as np

from jaxcam.errors import CheckpointError

LEGACY_MAGIC = 0x1950A86A20F9469CFC6C
"""The first pickle of a file in the old layout."""
MOST_PICKLE, MOST_STEPS = 2**25, 2**20
"""Bytes and instructions of the longest pickle that is read; that of 500 tensors has 20,000."""
MOST_DIRECTORY = 2**22
"""Bytes of an archive's list of files, in memory ten times as many; 500 tensors have 40,000."""
MOST_AXES, MOST_NESTED = 64, 100
"""Axes of a tensor, and containers around it."""

_STORAGES = {
    "DoubleStorage": np.float64,
    "FloatStorage": np.float32,
    "HalfStorage": np.float16,
    "BFloat16Storage": ml_dtypes.bfloat16,
    "LongStorage": np.int64,
    "IntStorage": np.int32,
    "ShortStorage": np.int16,
    "CharStorage": np.int8,
    "ByteStorage": np.uint8,
    "BoolStorage": np.bool_,
    "ComplexFloatStorage": np.complex64,
    "ComplexDoubleStorage": np.complex128,
    "UntypedStorage": np.uint8,
}
_TYPES = {
    name: getattr(ml_dtypes, name) if hasattr(ml_dtypes, name) else getattr(np, name)
    for name in (
        "float8_e4m3fn", "float8_e4m3fnuz", "float8_e5m2", "float8_e5m2fnuz", "float8_e8m0fnu",
        "uint16", "uint32", "uint64",
    )
}  # fmt: skip
"""Types whose storages are bytes, and whose tensors say what these are."""
_TENSOR_WORDS = re.compile(r"_rebuild_\w+|\w*Storage|[a-z]*(int|float|complex|bits|bool)\d*\w*")
"""PyTorch's words for tensors and their types, those that are not read here too."""


@dataclass(frozen=True)
class _Storage:
    """A flat array that tensors are windows of, by its name in the file."""

    dtype: np.dtype
    key: str
    count: int


@dataclass(frozen=True)
class _Tensor:
    """A tensor whose storage is not read yet."""

    storage: _Storage
    offset: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]
    dtype: np.dtype


class _Mapping(OrderedDict[Any, Any]):
    """Names and values; what PyTorch keeps as attributes of a mapping is left out."""

    def __setstate__(self, state: object) -> None:
        """Leaves out attributes."""


class _RefusedError(Exception):
    """The file asks for something else than tensors and containers."""


class _UnknownTensorError(Exception):
    """The file holds a kind of tensor that is not read here."""


class _OutsizedError(Exception):
    """The file asks for much more memory than it takes itself."""


class _Allowance:
    """Bytes that may still be taken for what a file holds.

    Args:
        size: Of the file.
    """

    def __init__(self, size: int) -> None:
        self._unused = 4 * size + 2**24

    def take(self, count: int) -> None:
        """Count bytes as taken; `_OutsizedError` if they are too many."""
        self._unused -= count
        if self._unused < 0:
            raise _OutsizedError


class _Unpickler(pickle.Unpickler):
    """Unpickles tensors and plain containers.

    Args:
        file: The pickle.
        allowance: For what it copies.
    """

    def __init__(self, file: IO[bytes], allowance: _Allowance) -> None:
        super().__init__(file)
        self._allowance = allowance

    def find_class(self, module: str, name: str) -> Any:
        """What a name in the file stands for."""
        allowed: dict[tuple[str, str], Any] = {
            ("collections", "OrderedDict"): self._mapping,
            ("torch", "Size"): self._size,
            ("torch._utils", "_rebuild_tensor"): self._tensor,
            ("torch._utils", "_rebuild_tensor_v2"): self._tensor,
            ("torch._utils", "_rebuild_tensor_v3"): self._typed_tensor,
            ("torch._utils", "_rebuild_parameter"): self._parameter,
        }
        if (module, name) in allowed:
            return allowed[module, name]
        if module in ("torch", "torch.storage") and name in {*_STORAGES, *_TYPES}:
            return name
        if module.split(".")[0] == "torch" and _TENSOR_WORDS.fullmatch(name):
            raise _UnknownTensorError(f"{module}.{name}")
        raise _RefusedError(f"{module}.{name}")

    def persistent_load(self, pid: Any) -> _Storage:
        """What PyTorch keeps beside the pickle: storages."""
        kind, storage, key, _, count, *_ = pid
        if kind != "storage":
            raise _RefusedError(f"a persistent {kind}")
        if not isinstance(key, str | int):
            raise ValueError("a storage without a name")
        return _Storage(np.dtype(_STORAGES[storage]), str(key), int(count))

    def _mapping(self, pairs: Any = ()) -> _Mapping:
        self._allowance.take(100 * len(pairs))
        return _Mapping(pairs)

    def _size(self, axes: Any = ()) -> tuple[int, ...]:
        if len(axes) > MOST_AXES:
            raise ValueError(f"a tensor with {len(axes)} axes")
        return tuple(map(int, axes))

    def _tensor(
        self, storage: _Storage, offset: int, shape: Any, strides: Any, *_: object
    ) -> _Tensor:
        axes = self._size(shape), self._size(strides)
        return _Tensor(storage, int(offset), *axes, storage.dtype)

    def _typed_tensor(self, *about: Any) -> _Tensor:
        storage, offset, shape, strides, _, _, name, *_ = about
        tensor = self._tensor(storage, offset, shape, strides)
        return replace(tensor, dtype=np.dtype(_TYPES[name]))

    def _parameter(self, tensor: _Tensor, *_: object) -> _Tensor:
        return tensor


def _unpickled(file: IO[bytes], allowance: _Allowance) -> Any:
    """What the next pickle of a file holds; the file is then behind it.

    Its instructions are counted before any is obeyed, and so are places of its memo, which the
    library makes room for however high their number is.
    """
    start = file.tell()
    content = io.BytesIO(file.read(MOST_PICKLE))
    for count, (instruction, argument, _) in enumerate(pickletools.genops(content)):
        place = argument if instruction.name in ("PUT", "BINPUT", "LONG_BINPUT") else 0
        if count >= MOST_STEPS or not isinstance(place, int) or place > MOST_STEPS:
            raise _OutsizedError
    length = content.tell()
    content.seek(0)
    value = _Unpickler(content, allowance).load()
    file.seek(start + length)
    return value


def read_torch(path: str | Path) -> dict[str, np.ndarray]:
    """All tensors of a file, by their names.

    Args:
        path: A `.pt` or `.pth` file.

    Returns:
        Arrays; names inside of containers are joined by dots. Whatever is not a tensor is left out.

    Raises:
        CheckpointError: The file is damaged, or holds more than tensors and plain containers.
    """
    try:
        allowance = _Allowance(Path(path).stat().st_size)
        if zipfile.is_zipfile(path):
            if _directory_size(Path(path)) > MOST_DIRECTORY:
                raise _OutsizedError
            with zipfile.ZipFile(path) as archive:
                return _read_zip(archive, allowance)
        with open(path, "rb") as file:
            return _read_legacy(file, allowance)
    except _OutsizedError as error:
        raise CheckpointError(
            f"{path} would take far more memory than its size of "
            f"{Path(path).stat().st_size:,} bytes explains, so it is not read."
        ) from error
    except _UnknownTensorError as error:
        raise CheckpointError(
            f"{path} holds tensors of a kind that is not read here ({error}). Save them as plain "
            "float32 ones: torch.save({k: v.float() for k, v in model.state_dict().items()}, ...)."
        ) from error
    except _RefusedError as error:
        raise CheckpointError(
            f"{path} holds more than tensors: {error}. It is not opened, since a pickle can run "
            "any program. Save its tensors alone, where you trust it, with torch.save("
            "model.state_dict(), ...) or as .safetensors."
        ) from error
    except OSError as error:
        raise CheckpointError(f"{path} cannot be read: {error}.") from error
    except Exception as error:  # A damaged pickle raises whatever its bytes happen to ask for.
        raise CheckpointError(
            f"{path} is not a whole PyTorch file ({type(error).__name__}: {error})."
        ) from error


def _directory_size(path: Path) -> int:
    """Bytes of the list of files in a zip archive, as the records at its end say.

    The record stands at the very end, or before a comment of up to 64 kB; one for large archives
    (zip64), and 20 bytes that point to it, stand right before it.
    """
    end, pointer, large = 22, 20, 56
    with path.open("rb") as file:
        size = file.seek(0, io.SEEK_END)
        file.seek(max(size - 2**16 - end - pointer - large, 0))
        tail = file.read()
    at = len(tail) - end
    if tail[at : at + 4] != b"PK\5\6" or tail[-2:] != b"\0\0":
        at = tail.rfind(b"PK\5\6")
    start = at - pointer - large
    if start >= 0 and tail[start : start + 4] == b"PK\6\6":
        return int.from_bytes(tail[start + 40 : start + 48], "little")
    return int.from_bytes(tail[at + 12 : at + 16], "little")


def _read_zip(archive: zipfile.ZipFile, allowance: _Allowance) -> dict[str, np.ndarray]:
    name = next(n for n in archive.namelist() if n.endswith("/data.pkl"))
    folder = name.removesuffix("data.pkl")
    order = folder + "byteorder"
    if order in archive.namelist():
        with archive.open(order) as file:
            if file.read(10) != b"little":
                raise ValueError("big-endian numbers")
    with archive.open(name) as file:
        content = _unpickled(file, allowance)
    storages: dict[str, np.ndarray] = {}

    def data(storage: _Storage) -> np.ndarray:
        if storage.key not in storages:
            entry = archive.getinfo(f"{folder}data/{storage.key}")
            allowance.take(entry.file_size)
            with archive.open(entry) as file:
                storages[storage.key] = np.frombuffer(file.read(entry.file_size), np.uint8)
        return storages[storage.key]

    return _arrays(content, data, allowance)


def _read_legacy(file: IO[bytes], allowance: _Allowance) -> dict[str, np.ndarray]:
    """Magic number, version, machine, content, names of the storages, then these."""
    if _unpickled(file, allowance) != LEGACY_MAGIC:
        raise ValueError("no PyTorch magic number")
    _unpickled(file, allowance)
    if not _unpickled(file, allowance).get("little_endian", True):
        raise ValueError("big-endian numbers")
    content = _unpickled(file, allowance)
    keys = [str(key) for key in _unpickled(file, allowance) if isinstance(key, str | int)]
    dtypes = {t.storage.key: t.storage.dtype for _, t in _walk(content, (), allowance)}
    storages = {}
    for key in keys:
        size = int.from_bytes(file.read(8), "little") * dtypes[key].itemsize
        allowance.take(size)
        storages[key] = np.frombuffer(file.read(size), np.uint8, size)
    return _arrays(content, lambda storage: storages[storage.key], allowance)


def _arrays(
    content: Any, data: Callable[[_Storage], np.ndarray], allowance: _Allowance
) -> dict[str, np.ndarray]:
    """The tensors of a file, whose storages `data` gives as bytes."""
    arrays: dict[str, np.ndarray] = {}
    for path, tensor in _walk(content, (), allowance):
        if (name := ".".join(path)) in arrays:
            raise ValueError(f"two tensors are called {name}")
        arrays[name] = _window(tensor, data(tensor.storage), allowance)
    return arrays


def _walk(
    value: Any, path: tuple[str, ...], allowance: _Allowance
) -> Iterator[tuple[tuple[str, ...], _Tensor]]:
    """Every tensor inside of nested containers with the names that lead to it."""
    if not isinstance(value, _Tensor | Mapping | list | tuple):
        return
    allowance.take(100 + sum(map(len, path)) + 4 * (not isinstance(value, _Tensor) and len(value)))
    if len(path) > MOST_NESTED:
        raise ValueError(f"more than {MOST_NESTED} containers inside of each other")
    if isinstance(value, _Tensor):
        yield path, value
    elif isinstance(value, Mapping):
        for key, part in value.items():
            if not isinstance(key, str | int | float | None):
                raise ValueError("a name that is neither text nor a number")
            yield from _walk(part, (*path, str(key)), allowance)
    else:
        for i, part in enumerate(value):
            yield from _walk(part, (*path, str(i)), allowance)


def _window(tensor: _Tensor, raw: np.ndarray, allowance: _Allowance) -> np.ndarray:
    """A copy of the part of a storage that a tensor shows."""
    dtype = tensor.dtype
    if 0 in tensor.shape:
        return np.zeros(tensor.shape, dtype)
    # Bytes without a meaning, since NumPy's windows know no float8.
    data = raw[: raw.size // dtype.itemsize * dtype.itemsize].view(f"V{dtype.itemsize}")
    steps = [(n - 1) * s for n, s in zip(tensor.shape, tensor.strides, strict=True)]
    if min(tensor.offset, *steps, 0) < 0 or tensor.offset + sum(steps) >= data.size:
        raise ValueError("a tensor reaches beyond its storage")
    allowance.take(math.prod(tensor.shape) * dtype.itemsize)
    strides = [s * dtype.itemsize for s in tensor.strides]
    window = np.lib.stride_tricks.as_strided(data[tensor.offset :], tensor.shape, strides)
    return np.array(window).view(dtype)
