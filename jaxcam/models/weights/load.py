"""Weights from elsewhere, looked at and loaded, and ours in PyTorch's layout.

Files are `.safetensors`, or PyTorch's `.pt` and `.pth`, read without PyTorch. What a file is, its
names tell. Loading is strict: every parameter that the file's kind covers must be in it with its
shape, and everything in it must have a place here, or be known to have none.
"""

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from jaxcam.errors import CheckpointError
from jaxcam.files.paths import absolute
from jaxcam.files.whole import write_atomically
from jaxcam.models.policy import Params
from jaxcam.models.weights.names import MAPS, NameMap, recognise
from jaxcam.models.weights.torch_files import read_torch

SHOWN = 5
"""Names of a kind that an error lists."""


@dataclass(frozen=True)
class Weights:
    """The arrays of a file."""

    path: Path
    arrays: dict[str, np.ndarray]
    """By their names in the file."""
    kind: NameMap | None
    """How they are laid out, if that is known."""
    sha256: str
    """Of the file, for the record of a run."""


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
    arrays = _read_safetensors(path) if path.suffix == ".safetensors" else read_torch(path)
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    return Weights(path, arrays, recognise(list(arrays)), sha256)


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
            return {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise CheckpointError(f"{path} is not a whole .safetensors file: {error}.") from error


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
    theirs = _fold_batch_norms(kind.prepare(_cut(weights.arrays, kind.prefix)))
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
                if key == "kernel" and array.ndim == 4 and array.shape[2] == 3 < value.shape[2]:
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


def _cut(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    matches = ((re.match(prefix, name), name) for name in arrays)
    return {name[match.end() :]: arrays[name] for match, name in matches if match}


def _fold_batch_norms(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Batch norms as the scale and bias that they are once their statistics stand still."""
    folded = dict(arrays)
    for name in arrays:
        if name.endswith(".running_var"):
            norm = name.removesuffix("running_var")
            folded.pop(norm + "num_batches_tracked", None)
            weight, bias, mean, var = (
                folded.pop(norm + part).astype(np.float32)
                for part in ("weight", "bias", "running_mean", "running_var")
            )
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
    def listed(what: str, names: list[str]) -> str:
        more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
        return f" {len(names)} {what}: {', '.join(names[:SHOWN])}{more}." if names else ""

    title = weights.kind.title if weights.kind else ""
    hint = ""
    if any("frozen" in name for name in extra):
        hint = " Batch norms with statistics need --model norm=frozen."
    return (
        f"{weights.path} looks like {title}, but is not this network."
        + listed("names are missing", missing)
        + listed("names have no place here", extra)
        + listed("shapes differ", wrong)
        + hint
    )


def show(weights: Weights) -> None:
    """Print what a file is, and its arrays."""
    table = Table("name", "shape", "type", box=None)
    for name, array in weights.arrays.items():
        table.add_row(name, "x".join(map(str, array.shape)) or "scalar", str(array.dtype))
    console = Console()
    console.print(table)
    count = sum(array.size for array in weights.arrays.values())
    kind = weights.kind.title if weights.kind else "of an unknown kind"
    console.print(f"{weights.path}: {kind}, {len(weights.arrays)} arrays, {count:,} numbers")
    console.print(f"sha256 {weights.sha256}", soft_wrap=True)
