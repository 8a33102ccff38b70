"""Read PyTorch's `.pt` and `.pth` files without PyTorch, and without running what is in them.

Such a file is a pickle, which may call anything. The reader here knows the few names that tensors
and plain containers need and refuses every other one. Both layouts are read: the zip archive that
PyTorch writes since 1.6, and the row of pickles from before.
"""

import pickle
import zipfile
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import ml_dtypes
import numpy as np

from jaxcam.errors import CheckpointError

LEGACY_MAGIC = 0x1950A86A20F9469CFC6C
"""The first pickle of a file in the old layout."""

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
}


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


class _RefusedError(Exception):
    """The file asks for something else than tensors and containers."""


class _Unpickler(pickle.Unpickler):
    """Unpickles tensors and plain containers."""

    def find_class(self, module: str, name: str) -> Any:
        """What a name in the file stands for."""
        allowed: dict[tuple[str, str], Any] = {
            ("collections", "OrderedDict"): OrderedDict,
            ("torch", "Size"): tuple,
            ("torch._utils", "_rebuild_tensor"): self._tensor,
            ("torch._utils", "_rebuild_tensor_v2"): self._tensor,
            ("torch._utils", "_rebuild_parameter"): self._parameter,
        }
        if (module, name) in allowed:
            return allowed[module, name]
        if module == "torch" and name in _STORAGES:
            return name
        raise _RefusedError(f"{module}.{name}")

    def persistent_load(self, pid: Any) -> _Storage:
        """What PyTorch keeps beside the pickle: storages."""
        kind, storage, key, _, count, *_ = pid
        if kind != "storage":
            raise _RefusedError(f"a persistent {kind}")
        return _Storage(np.dtype(_STORAGES[storage]), str(key), int(count))

    def _tensor(
        self, storage: _Storage, offset: int, shape: Any, strides: Any, *_: object
    ) -> _Tensor:
        return _Tensor(storage, int(offset), tuple(map(int, shape)), tuple(map(int, strides)))

    def _parameter(self, tensor: _Tensor, *_: object) -> _Tensor:
        return tensor


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
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                return _read_zip(archive)
        with open(path, "rb") as file:
            return _read_legacy(file)
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


def _read_zip(archive: zipfile.ZipFile) -> dict[str, np.ndarray]:
    name = next(n for n in archive.namelist() if n.endswith("/data.pkl"))
    folder = name.removesuffix("data.pkl")
    order = folder + "byteorder"
    if order in archive.namelist() and archive.read(order) != b"little":
        raise ValueError("big-endian numbers")
    with archive.open(name) as file:
        content = _Unpickler(file).load()
    storages: dict[str, np.ndarray] = {}

    def data(storage: _Storage) -> np.ndarray:
        if storage.key not in storages:
            raw = archive.read(f"{folder}data/{storage.key}")
            storages[storage.key] = np.frombuffer(raw, storage.dtype)
        return storages[storage.key]

    return _arrays(content, data)


def _read_legacy(file: IO[bytes]) -> dict[str, np.ndarray]:
    """Magic number, version, machine, content, names of the storages, then these."""
    if _Unpickler(file).load() != LEGACY_MAGIC:
        raise ValueError("no PyTorch magic number")
    _Unpickler(file).load()
    if not _Unpickler(file).load().get("little_endian", True):
        raise ValueError("big-endian numbers")
    content = _Unpickler(file).load()
    keys = [str(key) for key in _Unpickler(file).load()]
    dtypes = {t.storage.key: t.storage.dtype for _, t in _walk(content, ())}
    storages = {}
    for key in keys:
        count = int.from_bytes(file.read(8), "little")
        dtype = dtypes[key]
        storages[key] = np.frombuffer(file.read(count * dtype.itemsize), dtype, count)
    return _arrays(content, lambda storage: storages[storage.key])


def _arrays(content: Any, data: Callable[[_Storage], np.ndarray]) -> dict[str, np.ndarray]:
    return {
        ".".join(path): _window(tensor, data(tensor.storage)) for path, tensor in _walk(content, ())
    }


def _walk(value: Any, path: tuple[str, ...]) -> list[tuple[tuple[str, ...], _Tensor]]:
    """Every tensor inside of nested containers with the names that lead to it."""
    if isinstance(value, _Tensor):
        return [(path, value)]
    if isinstance(value, Mapping):
        pairs = [(str(k), v) for k, v in value.items()]
    elif isinstance(value, list | tuple):
        pairs = [(str(i), v) for i, v in enumerate(value)]
    else:
        return []
    return [pair for name, v in pairs for pair in _walk(v, (*path, name))]


def _window(tensor: _Tensor, data: np.ndarray) -> np.ndarray:
    """A copy of the part of a storage that a tensor shows."""
    if 0 in tensor.shape:
        return np.zeros(tensor.shape, data.dtype)
    steps = [(n - 1) * s for n, s in zip(tensor.shape, tensor.strides, strict=True)]
    if min(tensor.offset, *steps, 0) < 0 or tensor.offset + sum(steps) >= data.size:
        raise ValueError("a tensor reaches beyond its storage")
    strides = [s * data.itemsize for s in tensor.strides]
    return np.array(np.lib.stride_tricks.as_strided(data[tensor.offset :], tensor.shape, strides))
