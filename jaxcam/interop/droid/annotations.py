"""What is known of DROID's episodes beside their steps: metadata, and later annotations."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from jaxcam.config.fields import as_record
from jaxcam.errors import DatasetError
from jaxcam.files.json import read_json

INSTRUCTIONS = ("droid_language_annotations.json", "aggregated-annotations-030724.json")
EXTRINSICS = ("cam2base_extrinsics.json", "cam2base_extrinsic_superset.json")
INTRINSICS = "intrinsics.json"


@dataclass(frozen=True)
class Metadata:
    """What is used of an episode's `metadata_<uuid>.json`."""

    uuid: str = ""
    """Of the episode."""
    success: bool | None = None
    """Whether the operator called it one."""
    current_task: str | None = None
    """What the operator was asked to do."""
    wrist_cam_serial: str | None = None
    ext1_cam_serial: str | None = None
    ext2_cam_serial: str | None = None
    """Which camera is which."""
    wrist_cam_extrinsics: tuple[float, ...] | None = None
    ext1_cam_extrinsics: tuple[float, ...] | None = None
    ext2_cam_extrinsics: tuple[float, ...] | None = None
    """Six numbers each, of the first step."""


@dataclass(frozen=True)
class Annotations:
    """What the authors found out later, by an episode's uuid (huggingface.co/KarlP/droid)."""

    instructions: dict[str, Any]
    """Three sentences of each."""
    extrinsics: dict[Path, dict[str, Any]]
    """Of each file: six numbers by a camera's serial, recalibrated."""
    intrinsics: tuple[Path, dict[str, Any]]
    """fx, cx, fy and cy by a camera's serial."""


def read_annotations(folder: Path) -> Annotations:
    """The annotations in a folder; what is not there is empty.

    Raises:
        DatasetError: One of them is damaged.
    """
    instructions = [_object(folder / name) for name in INSTRUCTIONS if (folder / name).exists()]
    extrinsics = [folder / name for name in EXTRINSICS if (folder / name).exists()]
    intrinsics = folder / INTRINSICS
    return Annotations(
        instructions[0] if instructions else {},
        {path: _object(path) for path in extrinsics},
        (intrinsics, _object(intrinsics) if intrinsics.exists() else {}),
    )


def read_metadata(folder: Path) -> Metadata:
    """An episode's metadata; all is unknown where there is none.

    Raises:
        DatasetError, ConfigError: It is damaged, or a value is of another kind.
    """
    files = sorted(folder.glob("metadata_*.json"))
    if not files:
        return Metadata(uuid=folder.name)
    content = _object(files[0])
    known = {f.name: content[f.name] for f in fields(Metadata) if f.name in content}
    uuid = files[0].stem.removeprefix("metadata_")
    return as_record(Metadata, {"uuid": uuid} | known, str(files[0]))


def instruction_of(metadata: Metadata, annotations: Annotations) -> str:
    """What was asked for in an episode, in words; the authors' sentence where there is one."""
    sentences = annotations.instructions.get(metadata.uuid)
    sentence = sentences.get("language_instruction1") if isinstance(sentences, dict) else None
    return (sentence if isinstance(sentence, str) else metadata.current_task) or ""


def _object(path: Path) -> dict[str, Any]:
    content = read_json(path)
    if not isinstance(content, dict):
        raise DatasetError(f"{path}: expected names with values.")
    return content
