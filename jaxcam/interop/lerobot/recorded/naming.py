"""Which of a LeRobot folder's features are what, and how their numbers are called."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxcam.errors import DatasetError, closest
from jaxcam.interop.lerobot.recorded.meta import Feature

INDICES = ("episode_index", "frame_index", "index", "task_index", "timestamp")
"""Columns of LeRobot's own."""
STATES = ("observation.state", "state")
"""Where states are, in order of choice; several columns may begin so, followed by a dot."""
ACTIONS = ("action", "actions")
"""Where actions are, in the same way."""
_DEEPEST = 8
_PREFIXES = ("observation.images.", "observation.")


def view_names(features: Mapping[str, Feature], where: str) -> dict[str, str]:
    """Names of the cameras, and of each one the feature: `top` of `observation.images.top`.

    Args:
        features: By name.
        where: The file that names them, for messages.

    Raises:
        DatasetError: There are none, or two have one name, or one has a name that is a path.
    """
    views: dict[str, str] = {}
    for key, feature in features.items():
        if not feature.is_picture:
            continue
        prefix = next((p for p in _PREFIXES if key.startswith(p) and key != p), "")
        view = key.removeprefix(prefix)
        if "/" in view or view in (".", ".."):
            raise DatasetError(f"{where}: the feature '{key}' has a name that is a path.")
        if view in views:
            raise DatasetError(
                f"{where}: the features '{views[view]}' and '{key}' both are the view '{view}'. "
                "Call one of them otherwise."
            )
        views[view] = key
    if not views:
        raise DatasetError(
            f"{where} names no videos and no images: there is nothing to see. Its features are "
            f"{', '.join(features)}."
        )
    return views


def columns_of(
    features: Mapping[str, Feature], asked: Sequence[str], known: Sequence[str], where: str
) -> tuple[str, ...]:
    """The features that together are the state, or the action.

    Args:
        features: By name.
        asked: Names that the user gave; none if empty.
        known: Names to look for then.
        where: The file that names them, for messages.

    Raises:
        DatasetError: There is no such feature.
    """
    there = [k for k, f in features.items() if f.dtype not in ("video", "image", "string")]
    there = [k for k in there if k not in INDICES]
    for name in asked:
        if name not in there:
            raise DatasetError(f"{where} has no numbers called '{name}'{closest(name, there)}")
    if asked:
        return tuple(asked)
    for name in known:
        parts = [k for k in there if k.startswith(f"{name}.")]
        if name in there or parts:
            return (name,) if name in there else tuple(parts)
    raise DatasetError(
        f"{where} has no feature '{known[0]}'. Say which of its features are meant: "
        f"{', '.join(there) or 'it has no numbers'}."
    )


def number_names(
    features: Mapping[str, Feature], columns: Sequence[str], sizes: Sequence[int], where: str
) -> tuple[str, ...]:
    """Names of the numbers of columns, one behind the other.

    A column's own names are taken where it has as many as numbers; where it has one name, or names
    of its axes, its numbers are counted. Of several columns each number has the column's name too.

    Args:
        features: By name.
        columns: Names of the features.
        sizes: How many numbers each one has.
        where: The file that names them, for messages.

    Raises:
        DatasetError: A column has names for another number of numbers, or two have one name.
    """
    names: list[str] = []
    for column, size in zip(columns, sizes, strict=True):
        feature, last = features[column], column.rpartition(".")[2]
        if feature.shape and math.prod(feature.shape) != size:
            raise DatasetError(
                f"{where}: '{column}' is said to be {list(feature.shape)}, and its rows have "
                f"{size} numbers."
            )
        own = _labels(feature.names, where)
        if len(own) != size:
            if len(own) > 1 and len(feature.shape) < 2:
                raise DatasetError(
                    f"{where}: '{column}' has {size} numbers and {len(own)} names: "
                    f"{', '.join(own)}."
                )
            own = [last] if size == 1 else [f"{last}_{i}" for i in range(size)]
            own = own if len(columns) == 1 else [name.removeprefix(f"{last}_") for name in own]
        names += own if len(columns) == 1 else [f"{last}.{name}" for name in own]
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise DatasetError(
            f"{where}: {', '.join(columns)} has two numbers called '{doubled[0]}'. Call one of "
            "them otherwise."
        )
    return tuple(names)


def _labels(names: Any, where: str, depth: int = 0) -> list[str]:
    """A feature's names as a list: of a list, of lists in a dict, or of a dict's places."""
    if depth > _DEEPEST:
        raise DatasetError(f"{where} has names in lists in lists in lists, {depth} deep.")
    if isinstance(names, Mapping):
        places = list(names.values())
        if all(type(place) is int for place in places):
            return sorted(names, key=lambda name: names[name])
        parts = [_labels(part, where, depth + 1) for part in places]
        if len(parts) == 1:
            return parts[0]
        return [f"{key}.{name}" for key, part in zip(names, parts, strict=True) for name in part]
    if isinstance(names, Sequence) and not isinstance(names, str):
        return [label for name in names for label in _labels(name, where, depth + 1)]
    return [] if names is None else [str(names)]


def constant(values: np.ndarray) -> np.ndarray:
    """The first of values [T, ...] where they are all the same, else all of them."""
    return values[0] if (values == values[0]).all() else values
