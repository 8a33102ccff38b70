"""What the JSON files of a checkpoint hold: the names that must be there, and their types."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxcam.config.fields import as_record
from jaxcam.errors import ConfigError


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


def read_object(path: Path) -> dict[str, Any]:
    """The object that a JSON file holds.

    Raises:
        ConfigError: It cannot be read or holds something else.
    """
    if not path.is_file():
        raise ConfigError(f"there is no file {path.name}")
    try:
        content = json.loads(path.read_text("utf-8"))
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
