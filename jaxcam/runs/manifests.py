"""What the checkpoints of a run say of themselves, without a look at their arrays.

A checkpoint's manifest is JSON with a digest of itself; its `side` holds the settings, the data and
the packages that it was trained with.
"""

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxcam.config.fields import as_record
from jaxcam.errors import ConfigError
from jaxcam.files.paths import read_text


class DamagedError(Exception):
    """Why a checkpoint cannot be used."""


@dataclass(frozen=True)
class Side:
    """What lies beside a checkpoint's arrays, see `jaxcam.training.side.make_side`."""

    seed: int
    config: dict[str, Any]
    settings: dict[str, Any]
    spec: dict[str, Any]
    stats: dict[str, Any]
    data: Any
    convention: int
    packages: dict[str, str]


@dataclass(frozen=True)
class Manifest:
    """A manifest without its seal."""

    step: int
    side: dict[str, Any]
    leaves: dict[str, list[Any]]
    """Dtype, shape and digest of each array."""


@dataclass(frozen=True)
class Files:
    """Digests of a checkpoint's files by their names, without their seal."""

    files: dict[str, str]


@dataclass(frozen=True)
class StartingWeights:
    """What weights a run started from, as its `weights.json` has it.

    Attributes:
        kind: What they are; None where nobody knew.
        sha256: Of the file.
        file: Their path.
    """

    kind: str | None
    sha256: str = ""
    file: str = ""


def record_of_weights(run: Path) -> StartingWeights | None:
    """What weights a run started from; None where it has no record of any.

    Args:
        run: Folder of the run.

    Raises:
        ConfigError: The record is not what was written.
    """
    file = run / "weights.json"
    if not file.exists():
        return None
    try:
        return as_record(StartingWeights, read_object(file), str(file))
    except ConfigError as error:
        raise ConfigError(
            f"{file} is damaged: {error}. Restore it, or delete it: the weights are then known "
            "by their path."
        ) from error


def read_object(path: Path) -> dict[str, Any]:
    """The object that a JSON file holds.

    Raises:
        ConfigError: It cannot be read or holds something else.
    """
    if not path.is_file():
        raise ConfigError(f"there is no file {path.name}")
    try:
        content = json.loads(read_text(path))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{type(error).__name__}: {str(error)[:200]}") from error
    if not isinstance(content, dict):
        raise ConfigError(f"it is a JSON {type(content).__name__}, not an object")
    return content


def check_manifest(content: dict[str, Any]) -> None:
    """Refuse a manifest whose content is not of the form that is written.

    Raises:
        ConfigError: A name is missing or unknown, or a value of another type.
    """
    manifest = as_record(Manifest, content, "manifest")
    # A newer version may have put more there.
    known = {name: v for name, v in manifest.side.items() if name in Side.__dataclass_fields__}
    as_record(Side, known, "manifest's side")
    for name, described in manifest.leaves.items():
        fits = len(described) == 3 and isinstance(described[1], list)
        if not fits or not all(type(size) is int and size >= 0 for size in described[1]):
            raise ConfigError(f"manifest: {name} is described as {described!r:.80}.")


def seal(content: dict[str, Any]) -> dict[str, Any]:
    """The content with a digest of itself."""
    text = json.dumps(content, sort_keys=True)
    return {**content, "sha256": hashlib.sha256(text.encode()).hexdigest()}


def without_seal(content: Mapping[str, Any]) -> dict[str, Any]:
    """The content that `seal` was given."""
    return {name: value for name, value in content.items() if name != "sha256"}


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a checkpoint.

    Args:
        folder: Of the checkpoint; its name is the step.

    Raises:
        DamagedError: It is not what was written.
    """
    try:
        manifest = read_object(folder / "manifest" / "metadata")
        content = without_seal(manifest)
        check_manifest(content)
    except ConfigError as error:
        raise DamagedError(f"its manifest cannot be read ({str(error)[:200]})") from error
    if manifest != seal(content):
        raise DamagedError("its manifest has changed since it was written")
    if str(manifest["step"]) != folder.name:
        raise DamagedError(f"its manifest is of step {manifest['step']}")
    return manifest


def steps_in(directory: Path) -> list[int]:
    """Steps that have a checkpoint in a folder of them, oldest first."""
    if not directory.is_dir():
        return []
    names = [path.name for path in directory.iterdir()]
    # isdigit alone takes other alphabets' digits, superscripts and leading zeros too.
    return sorted(int(name) for name in names if re.fullmatch("0|[1-9][0-9]*", name))


def sides(run: Path) -> dict[int, Mapping[str, Any]]:
    """What a run's whole checkpoints hold beside their arrays, by step."""
    whole: dict[int, Mapping[str, Any]] = {}
    directory = run / "checkpoints"
    for step in steps_in(directory):
        try:
            whole[step] = read_manifest(directory / str(step))["side"]
        except DamagedError:
            continue
    return whole
