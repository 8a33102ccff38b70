"""Weights from elsewhere, looked at and loaded, and ours in PyTorch's layout.

Files are `.safetensors`, or PyTorch's `.pt` and `.pth`, read without PyTorch. What a file is, its
names tell. Loading is strict: every parameter that the file's kind covers must be in it with its
shape, and everything in it must have a place here, or be known to have none.
"""

import hashlib
import json
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import ml_dtypes
import numpy as np
from rich.console import Console
from rich.table import Table

from jaxcam.errors import CheckpointError
from jaxcam.files.paths import absolute
from jaxcam.files.whole import write_atomically
from jaxcam.models.policy import Params
from jaxcam.models.weights.names import MAPS, NameMap, name_map_of, unwrap
from jaxcam.models.weights.torch_files import read_torch

LFS_HEAD = b"version https://git-lfs.github.com/spec/"
"""What the files begin with that Git LFS leaves where the large ones were not fetched."""
FLOAT8 = {
    "F8_E4M3": ml_dtypes.float8_e4m3fn,
    "F8_E5M2": ml_dtypes.float8_e5m2,
    "F8_E8M0": ml_dtypes.float8_e8m0fnu,
}
"""Types of safetensors that NumPy has no names for."""
READ = {"F64", "F32", "F16", "BF16", "I64", "I32", "I16", "I8", "U64", "U32", "U16", "U8", "BOOL",
        "C64", *FLOAT8}  # fmt: skip
"""Types of safetensors that are read."""
NORM, COUNTER = ("weight", "bias", "running_mean", "running_var"), "num_batches_tracked"
"""What PyTorch calls the arrays of a batch norm, and the count beside them."""
SHOWN = 5
"""Names of a kind that an error lists."""


@dataclass(frozen=True)
class Weights:
    """The arrays of a file."""

    path: Path
    arrays: dict[str, np.ndarray]
    """By their names in the file, without what wrappers put before them."""
    kind: NameMap | None
    """How they are laid out, if that is known."""
    sha256: str
    """Hash of the file, for the record of a run."""


def read_weights(path: str | Path) -> Weights:
    """Read a file of weights.

    Args:
        path: A `.safetensors`, `.pt` or `.pth` file.

    Raises:
        CheckpointError: There is no such file, or it is not whole or not of these kinds.
    """
    path = absolute(path)
    if path.is_dir():
        raise CheckpointError(
            f"{path} is a folder. Of a run, write a LeRobot checkpoint with --export FOLDER; of a "
            "LeRobot checkpoint, look at its model.safetensors or make a run with --run-dir FOLDER."
        )
    if not path.is_file():
        raise CheckpointError(f"There is no file {path}.")
    check_head(path)
    arrays = _read_safetensors(path) if path.suffix == ".safetensors" else read_torch(path)
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    arrays = unwrap(arrays)
    return Weights(path, arrays, name_map_of(list(arrays)), sha256)


def check_head(path: Path) -> None:
    """Refuse a file that is empty, or in whose place Git LFS has left a pointer.

    Args:
        path: A file of weights.

    Raises:
        CheckpointError: It is such a file, or cannot be read.
    """
    try:
        with path.open("rb") as file:
            head = file.read(len(LFS_HEAD))
    except OSError as error:
        raise CheckpointError(f"{path} cannot be read: {error.strerror}.") from error
    if not head:
        raise CheckpointError(f"{path} is empty: a download or a copy of it was not finished.")
    if head == LFS_HEAD:
        raise CheckpointError(
            f"{path} is a pointer of Git LFS, not the weights themselves: run `git lfs pull` in "
            "its repository, or download the file."
        )


def _read_safetensors(path: Path) -> dict[str, np.ndarray]:
    try:
        # Here, since only the extra `smolvla` brings it.
        from safetensors import SafetensorError, safe_open
    except ImportError as error:
        raise CheckpointError(
            "Reading .safetensors needs the package safetensors: pip install 'jaxcam[smolvla]'"
        ) from error
    try:
        with safe_open(path, framework="numpy") as file:
            types = {name: file.get_slice(name).get_dtype() for name in file.keys()}  # noqa: SIM118
            if odd := [f"{name} ({kind})" for name, kind in types.items() if kind not in READ]:
                raise CheckpointError(
                    f"{path} holds numbers of a kind that is not read here:"
                    + _listed("arrays are such", odd)
                    + " Save its weights as float32."
                )
            return {
                name: _float8(path, name, FLOAT8[kind]) if kind in FLOAT8 else file.get_tensor(name)
                for name, kind in types.items()
            }
    except (SafetensorError, TypeError) as error:
        raise CheckpointError(f"{path} is not a whole .safetensors file: {error}.") from error


def _float8(path: Path, name: str, dtype: Any) -> np.ndarray:
    """An array of a whole safetensors file: 8 bytes say how long the JSON is before the arrays."""
    with path.open("rb") as file:
        length = int.from_bytes(file.read(8), "little")
        about = json.loads(file.read(length))[name]
    shape, (start, _) = about["shape"], about["data_offsets"]
    return np.fromfile(path, dtype, math.prod(shape), offset=8 + length + start).reshape(shape)


def record_weights(folder: Path, weights: Weights) -> None:
    """Write down, in a run's folder, what weights it started from."""
    kind = weights.kind.title if weights.kind else None
    record = {"file": str(weights.path), "kind": kind, "sha256": weights.sha256}
    write_atomically(folder / "weights.json", json.dumps(record, indent=2) + "\n")


def load(weights: Weights, params: Mapping[str, Any], *, new_stem: bool = False) -> dict[str, Any]:
    """Parameters with those of a file in their place.

    Args:
        weights: From `read_weights`.
        params: A policy's parameters, or their shapes where the file has them all. What the file
            does not cover keeps its value.
        new_stem: Leave a first convolution alone that also takes a ray-map, as the paper's authors
            do. Else its colours get the file's kernel.

    Raises:
        CheckpointError: The file is of an unknown kind or of another network. Missing names, names
            without a place and wrong shapes are listed.
    """
    if weights.kind is None:
        known = ", ".join(m.title for m in MAPS)
        raise CheckpointError(
            f"{weights.path} is of an unknown kind. Known: {known}. Its names begin with "
            f"{', '.join(list(weights.arrays)[:SHOWN])}."
        )
    kind = weights.kind
    theirs = _prepared(weights, kind)
    unplaced, missing, wrong = set(theirs), [], []

    def place(node: Mapping[str, Any], path: tuple[str, ...]) -> dict[str, Any]:
        filled = {}
        for key, value in node.items():
            here = (*path, key)
            name = None if isinstance(value, Mapping) else kind.theirs(here)
            if isinstance(value, Mapping):
                filled[key] = place(value, here)
            elif name is None:
                filled[key] = value
            elif name not in theirs:
                missing.append(name)
            else:
                unplaced.discard(name)
                array = _from_torch(_as_linear(theirs[name], value.ndim), key)
                if key == "kernel" and _lacks_rays(array.shape, tuple(value.shape)):
                    array = value if new_stem else np.concatenate([array, value[:, :, 3:]], 2)
                if array.shape != tuple(value.shape):
                    expected, got = _torch_shape(value, key), theirs[name].shape
                    wrong.append(f"{name} (expected {expected}, got {got})")
                filled[key] = np.asarray(array, value.dtype)
        return filled

    filled = place(params, ())
    extra = sorted(name for name in unplaced if not re.fullmatch(kind.unused, name))
    if unplaced == set(theirs):
        raise CheckpointError(f"{weights.path} is {kind.title}; this policy has no place for it.")
    if missing or extra or wrong:
        raise CheckpointError(_complaint(weights, missing, extra, wrong))
    return filled


def to_torch(params: Params, kind: NameMap) -> dict[str, np.ndarray]:
    """Parameters in PyTorch's layout, by the names that a kind of file gives them; others' are out.

    Linear layers stay such, and batch norms have statistics that leave their scale as it is.
    """
    arrays = {}
    for path, leaf in jax.tree_util.tree_flatten_with_path(params)[0]:
        keys = tuple(step.key for step in path)
        if (name := kind.theirs(keys)) is not None:
            array = np.asarray(leaf, np.float32)
            is_kernel, ndim = keys[-1] == "kernel", array.ndim
            turned = (*reversed(range(ndim - 2, ndim)), *range(ndim - 2)) if is_kernel else None
            arrays[name] = array.transpose(turned) if is_kernel else array
    return _unfold_batch_norms(arrays)


def load_after(
    init: Callable[[jax.Array], Params], weights: Weights, new_stem: bool
) -> Callable[[jax.Array], Params]:
    """A policy's `init`, with those of a file put in place of what it draws."""

    def loaded(key: jax.Array) -> Params:
        # Copies: an update donates its state, and must not be given memory that NumPy owns.
        return jax.tree.map(jnp.array, load(weights, init(key), new_stem=new_stem))

    return loaded


def _prepared(weights: Weights, kind: NameMap) -> dict[str, np.ndarray]:
    """A file's arrays by the names that its kind's map gives, batch norms folded."""
    cut = _cut(weights.arrays, kind.prefix)
    used = {name: array for name, array in cut.items() if not re.fullmatch(kind.unused, name)}
    odd = [
        f"{name} ({array.dtype})"
        for name, array in used.items()
        if not jnp.issubdtype(array.dtype, jnp.floating) and not name.endswith(COUNTER)
    ]
    if odd:
        raise CheckpointError(
            f"{weights.path} is {kind.title}, but not in floating-point numbers:"
            + _listed("arrays are of another type", odd)
            + " Save its weights as float32."
        )
    try:
        return _fold_batch_norms(kind.prepare(cut))
    except (KeyError, ValueError, IndexError) as error:
        raise CheckpointError(
            f"{weights.path} looks like {kind.title}, but its arrays cannot be taken apart as "
            f"those of one: {error}."
        ) from error


def _lacks_rays(theirs: tuple[int, ...], ours: tuple[int, ...]) -> bool:
    """Whether a kernel takes colours alone, and ours, like it otherwise, a ray-map too."""
    rest = theirs[:2] + theirs[3:] == ours[:2] + ours[3:]
    return len(theirs) == len(ours) == 4 and rest and theirs[2] == 3 < ours[2]


def _cut(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    matches = ((re.match(prefix, name), name) for name in arrays)
    return {name[match.end() :]: arrays[name] for match, name in matches if match}


def _fold_batch_norms(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Batch norms as the scale and bias that they are once their statistics stand still."""
    folded = dict(arrays)
    for name in arrays:
        norm = name.removesuffix("running_var")
        if name.endswith(".running_var") and all(norm + part in arrays for part in NORM):
            folded.pop(norm + COUNTER, None)
            weight, bias, mean, var = (folded.pop(norm + part).astype(np.float32) for part in NORM)
            scale = weight / np.sqrt(var + np.float32(1e-5))
            folded[norm + "frozen_scale"] = scale
            folded[norm + "frozen_bias"] = bias - mean * scale
    return folded


def _unfold_batch_norms(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The reverse of `_fold_batch_norms`: a mean of 0, and a variance that becomes 1."""
    unfolded = {}
    for name, array in arrays.items():
        norm, _, part = name.rpartition(".")
        if part == "frozen_scale":
            var = np.full_like(array, np.float32(1) - np.float32(1e-5))
            unfolded |= {
                f"{norm}.weight": array,
                f"{norm}.running_mean": np.zeros_like(array),
                f"{norm}.running_var": var,
            }
        else:
            unfolded[f"{norm}.bias" if part == "frozen_bias" else name] = array
    return unfolded


def _as_linear(array: np.ndarray, ndim: int) -> np.ndarray:
    """A 1x1 convolution as the matrix it is, where that is what we have."""
    return array.reshape(array.shape[:ndim]) if set(array.shape[ndim:]) == {1} else array


def _from_torch(array: np.ndarray, leaf: str) -> np.ndarray:
    """An array in our layout: outputs last."""
    if leaf != "kernel":
        return array
    return array.T if array.ndim < 3 else np.moveaxis(array, (0, 1), (-1, -2))


def _torch_shape(value: Any, leaf: str) -> tuple[int, ...]:
    shape = tuple(value.shape)
    return (*shape[:-3:-1], *shape[:-2]) if leaf == "kernel" else shape


def _complaint(weights: Weights, missing: list[str], extra: list[str], wrong: list[str]) -> str:
    title = weights.kind.title if weights.kind else ""
    hint = ""
    if any("frozen" in name for name in extra):
        hint = " Batch norms with statistics need --model norm=frozen."
    return (
        f"{weights.path} looks like {title}, but is not this network."
        + _listed("names are missing", missing)
        + _listed("names have no place here", extra)
        + _listed("shapes differ", wrong)
        + hint
    )


def _listed(what: str, names: list[str]) -> str:
    """A sentence about names, the first of them in full; empty if there are none."""
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return f" {len(names)} {what}: {', '.join(names[:SHOWN])}{more}." if names else ""


def show_weights(weights: Weights, console: Console) -> None:
    """Print what a file is, and its arrays."""
    table = Table("name", "shape", "type", box=None)
    for name, array in weights.arrays.items():
        table.add_row(name, "x".join(map(str, array.shape)) or "scalar", str(array.dtype))
    console.print(table)
    count = sum(array.size for array in weights.arrays.values())
    kind = weights.kind.title if weights.kind else "of an unknown kind"
    what = f"{weights.path}: {kind}, {len(weights.arrays)} arrays, {count:,} numbers"
    console.print(what, soft_wrap=True)
    console.print(f"sha256 {weights.sha256}", soft_wrap=True)
