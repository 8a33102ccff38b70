"""Files that say which tags there are, how large they are, and where they lie in the base frame.

    {
      "format": 1,
      "family": "36h11",
      "size": 0.08,
      "accuracy": 0.001,
      "tags": {
        "0": {"base_from_tag": {"position": [0.4, 0.1, 0], "quaternion_wxyz": [1, 0, 0, 0]}},
        "7": {"corners": [[…], […], […], […]]}
      }
    }

A tag's axes: x to its right and y to its top as its picture is read, z out of the paper; its middle
is the origin. So a tag that lies flat, face up, its right along the base's x, has no rotation. Its
corners are those of the black square: upper left, upper right, lower right, lower left.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from jaxcam.config.calibrate import TagFamily
from jaxcam.config.fields import as_record, check_types
from jaxcam.errors import ConfigError
from jaxcam.files.json import read_json
from jaxcam.interop.cameras.poses import PoseFile, checked_pose, place_of, real_numbers
from jaxcam.robot.calibration.boards import dictionary_of
from jaxcam.robot.calibration.projection import placed

FORMAT = 1
SQUARE = 0.1
"""Share by which measured sides of a tag may differ from its size."""


@dataclass(frozen=True)
class TagsEntries:
    """The entries of a file of tags."""

    format: int
    family: TagFamily
    tags: dict[str, Any]
    """`TagEntries` by the tag's number."""
    size: float | None = None
    """Side of the black square (m), of tags that do not say their own."""
    accuracy: float = 0.0
    """How well the tags' places are known (m), one standard deviation."""
    about: Any = None
    """Anything that the writer wants to keep."""

    def __post_init__(self) -> None:
        check_types(self, "tags: ")


@dataclass(frozen=True)
class TagEntries:
    """The entries of one tag; `base_from_tag` or `corners`."""

    base_from_tag: list[Any] | dict[str, Any] | None = None
    """Its pose: a 4x4 matrix, or position and quaternion_wxyz."""
    corners: list[Any] | None = None
    """Where its corners are in the base frame (m), as touched with the robot's tip, say."""
    size: float | None = None
    """Its own side (m)."""


@dataclass(frozen=True)
class Tags:
    """Tags at known places."""

    family: TagFamily
    corners: Mapping[int, np.ndarray] = field(repr=False)
    """By the tag's number, [4, 3] (m), from the upper left one clockwise."""
    sizes: Mapping[int, float]
    """Sides (m)."""
    accuracy: float
    """Of their places (m)."""


def square(size: float) -> np.ndarray:
    """Corners of a tag in its own axes, from the upper left one clockwise, [4, 3].

    Args:
        size: Its side (m).
    """
    h = size / 2
    return np.array([[-h, h, 0], [h, h, 0], [h, -h, 0], [-h, -h, 0]])


def read_tags(path: Path) -> Tags:
    """Reads a file of tags.

    Args:
        path: Of the file.

    Raises:
        ConfigError: It is no such file, or an entry of it means nothing.
        CameraError: A pose is none.
        DatasetError: It cannot be read.
    """
    where = str(path)
    entries = as_record(TagsEntries, read_json(path), where)
    if entries.format != FORMAT:
        raise ConfigError(f"{where}: format {entries.format}; expected {FORMAT}.")
    if not entries.tags:
        raise ConfigError(f"{where}: no tag in 'tags'.")
    if entries.accuracy < 0:
        raise ConfigError(f"{where}: accuracy is a length in metres, got {entries.accuracy:g}.")
    known, corners, sizes = len(dictionary_of(entries.family).bytesList), {}, {}
    for name, content in entries.tags.items():
        place = f"{where}: tag '{name}'"
        if not (name.isascii() and name.isdigit() and int(name) < known):
            raise ConfigError(f"{place}: {entries.family} has the numbers 0 to {known - 1}.")
        tag = as_record(TagEntries, content, place)
        size = entries.size if tag.size is None else tag.size
        if size is None or not 0.001 <= size <= 5:
            raise ConfigError(
                f"{place}: 'size' is the side of its black square in metres, 0.001 to 5; got "
                f"{size}. An 8 cm tag has 0.08."
            )
        corners[int(name)], sizes[int(name)] = _corners(tag, size, place, path.parent), size
    return Tags(entries.family, corners, sizes, entries.accuracy)


def _corners(tag: TagEntries, size: float, where: str, folder: Path) -> np.ndarray:
    if (tag.base_from_tag is None) == (tag.corners is None):
        raise ConfigError(f"{where}: expected either 'base_from_tag' or 'corners'.")
    if tag.base_from_tag is not None:
        place = place_of(tag.base_from_tag, f"{where}, base_from_tag", folder)
        if isinstance(place, PoseFile) or place.ndim != 2:
            raise ConfigError(f"{where}, base_from_tag: expected one pose.")
        return placed(checked_pose(place, f"{where}, base_from_tag"), square(size))
    corners = real_numbers(tag.corners, f"{where}, corners")
    if corners.shape != (4, 3):
        raise ConfigError(
            f"{where}, corners: shape {list(corners.shape)}; expected four points of three "
            "numbers: upper left, upper right, lower right, lower left."
        )
    sides = np.linalg.norm(corners - np.roll(corners, -1, 0), axis=-1)
    diagonals = np.linalg.norm(corners[:2] - corners[2:], axis=-1) / np.sqrt(2)
    lengths = np.concatenate([sides, diagonals])
    if (np.abs(lengths / size - 1) > SQUARE).any():
        raise ConfigError(
            f"{where}, corners: sides of {', '.join(f'{1000 * s:.0f}' for s in sides)} mm; "
            f"expected a square of {1000 * size:.0f} mm. Likely cause: corners of the "
            "white margin, in another order, or another 'size'."
        )
    return corners
