"""What is in a checkpoint, written so that any change of it is noticed.

Arrays are named by their path in the training state and stored by orbax in items. The manifest
lists each array's dtype, shape and SHA-256, and has a digest of itself; it is committed with them.
Digests of all files follow it, for the bytes that no array is made of. Where a crash came before
them, the manifest alone is what arrays are held against.
"""

import hashlib
import json
import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
import orbax.checkpoint as ocp

from jaxcam.config.fields import as_record
from jaxcam.errors import CheckpointError, ConfigError
from jaxcam.files.paths import absolute
from jaxcam.files.whole import write_atomically
from jaxcam.runs.manifests import (
    DamagedError,
    Files,
    read_manifest,
    read_object,
    seal,
    steps_in,
    without_seal,
)

FILES = "files.json"
"""File of a checkpoint with the digests of all its others."""


Read = Callable[[Path], tuple[dict[str, Any], dict[str, Any]]]
"""Reads a checkpoint's folder: its manifest, and arrays by name."""

_log = logging.getLogger(__name__)


def flatten(state: Any) -> dict[str, np.ndarray]:
    """The arrays of a training state by name."""
    paths = jax.tree_util.tree_leaves_with_path(state)
    return {leaf_name(path): np.asarray(leaf) for path, leaf in paths}


def leaf_name(path: Any) -> str:
    """An array's name, such as "params/encoder/conv/kernel"."""
    return jax.tree_util.keystr(path, simple=True, separator="/")


def item_of(name: str) -> str:
    """The orbax item that holds an array; evaluation reads one item, not the optimizer too."""
    first = name.split("/")[0]
    return first if first in ("params", "ema") else "train"


def describe(leaf: np.ndarray) -> list[Any]:
    """Dtype, shape and digest of an array."""
    digest = hashlib.sha256(np.ascontiguousarray(leaf).reshape(-1).view(np.uint8).data)
    return [str(leaf.dtype), list(leaf.shape), digest.hexdigest()]


def alone() -> ocp.options.MultiprocessingOptions:
    """Orbax's options for a process that reads and writes without waiting for others."""
    index = jax.process_index()
    return ocp.options.MultiprocessingOptions(primary_host=index, active_processes={index})


def write_digests(folder: Path) -> None:
    """Write down the digests of a checkpoint's files."""
    write_atomically(folder / FILES, json.dumps(seal({"files": _digests(folder)})))


def _digests(folder: Path, item: str | None = None) -> dict[str, str]:
    """Digests of the files of an item, or of all; those that lie loose belong to the manifest."""
    digests = {}
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        place, name = path.relative_to(folder), str(path.relative_to(folder))
        owner = place.parts[0] if len(place.parts) > 1 else "manifest"
        if item in (None, owner) and not name.startswith(FILES):
            with open(path, "rb") as file:
                digests[name] = hashlib.file_digest(file, "sha256").hexdigest()
    return digests


def _check_files(folder: Path, item: str) -> None:
    """Compare the files of an item with their digests, if those were written."""
    if not (folder / FILES).exists():
        return
    try:
        stored = read_object(folder / FILES)
        files = as_record(Files, without_seal(stored), FILES).files
    except ConfigError as error:
        raise DamagedError(f"{FILES} cannot be read ({brief(error)})") from error
    if stored != seal({"files": files}):
        raise DamagedError(f"{FILES} has changed since it was written")
    try:
        now = _digests(folder, item)
    except OSError as error:
        raise DamagedError(f"{item} cannot be read ({brief(error)})") from error
    owned = {n: d for n, d in files.items() if n.startswith(f"{item}/") or n in now}
    for name in sorted(owned | now):
        if owned.get(name) != now.get(name):
            raise DamagedError(f"the file {name} has changed since it was written")


def _read_manifest(folder: Path) -> dict[str, Any]:
    _check_files(folder, "manifest")
    manifest = read_manifest(folder)
    try:
        from_plain(manifest["side"])
    except (ValueError, TypeError) as error:
        raise DamagedError(f"its manifest has arrays that are none ({brief(error)})") from error
    return manifest


def _read_item(folder: Path, item: str, described: Mapping[str, list[Any]]) -> dict[str, Any]:
    """The arrays of one item, each compared with its description in the manifest."""
    _check_files(folder, item)
    stored = [name for name, (_, shape, _) in described.items() if 0 not in shape]
    as_numpy = {name: ocp.RestoreArgs(restore_type=np.ndarray) for name in stored}
    try:
        handler = ocp.PyTreeCheckpointHandler(multiprocessing_options=alone())
        with ocp.Checkpointer(handler, multiprocessing_options=alone()) as checkpointer:
            args = ocp.args.PyTreeRestore(restore_args=as_numpy)
            arrays = checkpointer.restore(folder / item, args=args) if stored else {}
    except Exception as error:  # Orbax raises bare exceptions for truncated files.
        raise DamagedError(f"{item} cannot be read ({brief(error)})") from error
    leaves = {}
    for name, (dtype, shape, digest) in described.items():
        try:
            leaf = arrays.get(name) if name in stored else np.zeros(shape, dtype)
        except (ValueError, TypeError) as error:
            raise DamagedError(f"{name} is described as {dtype!r}, {shape}") from error
        if leaf is None or describe(leaf) != [dtype, shape, digest]:
            raise DamagedError(f"{name} has changed since it was written")
        leaves[name] = leaf
    return leaves


def _read_items(folder: Path, manifest: dict[str, Any], items: set[str]) -> dict[str, Any]:
    leaves = {}
    for item in sorted(items):
        part = {n: d for n, d in manifest["leaves"].items() if item_of(n) == item}
        leaves |= _read_item(folder, item, part)
    return leaves


def read_all(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Manifest and all arrays of a checkpoint; `DamagedError` if anything has changed."""
    folder = absolute(folder)  # orbax takes no other path
    manifest = _read_manifest(folder)
    return manifest, _read_items(folder, manifest, {item_of(n) for n in manifest["leaves"]})


def read_params(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Like `read_all`, but only the parameters to evaluate: the moving average if there is one."""
    folder = absolute(folder)
    manifest = _read_manifest(folder)
    has_ema = any(item_of(n) == "ema" for n in manifest["leaves"])
    return manifest, _read_items(folder, manifest, {"ema" if has_ema else "params"})


def newest_whole(directory: Path, read: Read) -> tuple[dict[str, Any], dict[str, Any], list[int]]:
    """Manifest and arrays of the newest whole checkpoint, and the damaged steps after it.

    Args:
        directory: Folder of a run's checkpoints.
        read: `read_all` or `read_params`.

    Raises:
        CheckpointError: None is whole; the message lists why.
    """
    reasons: dict[int, str] = {}
    for step in reversed(steps_in(directory)):
        try:
            manifest, leaves = read(directory / str(step))
        except DamagedError as error:
            reasons[step] = str(error)
            _log.warning("CHECKPOINT %d IS DAMAGED, trying an older one: %s.", step, error)
            continue
        if reasons:
            _log.warning("Using checkpoint %d instead of %d.", step, max(reasons))
        return manifest, leaves, list(reasons)
    listed = "; ".join(f"{step}: {reason}" for step, reason in reasons.items())
    raise CheckpointError(f"No checkpoint in {directory} is whole. {listed}.")


def to_plain(value: Any) -> Any:
    """The value as plain JSON; arrays become {"dtype", "shape", "values"}."""
    if isinstance(value, Mapping):
        return {str(k): to_plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [to_plain(v) for v in value]
    if isinstance(value, (np.ndarray, np.generic, jax.Array)):
        array = np.asarray(value)
        content = {"shape": list(array.shape), "values": array.reshape(-1).tolist()}
        return {"dtype": str(array.dtype), **content}
    return value


def from_plain(value: Any) -> Any:
    """What `to_plain` was given, but with lists for tuples."""
    if isinstance(value, dict):
        if value.keys() == {"dtype", "shape", "values"}:
            return np.asarray(value["values"], value["dtype"]).reshape(value["shape"])
        return {k: from_plain(v) for k, v in value.items()}
    return value


def brief(error: BaseException) -> str:
    """The first line of an error, without the rest of a storage library's trace."""
    lines = str(error).splitlines() or [""]
    return f"{type(error).__name__}: {lines[0][:200]}"
