"""The rows of a LeRobot folder: each table is read once, and cut into episodes."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxcam.errors import DatasetError
from jaxcam.interop.lerobot.arrow import pa
from jaxcam.interop.lerobot.recorded.meta import EpisodePlace
from jaxcam.interop.lerobot.recorded.naming import INDICES
from jaxcam.interop.lerobot.recorded.tables import numbers, read_table


@dataclass(frozen=True)
class EpisodeRows:
    """The numbers of one episode of T steps."""

    place: EpisodePlace
    row: int
    """Of its first step in its table."""
    timestamps: np.ndarray
    """When its steps were (s), rising, float64 [T]."""
    tasks: tuple[int, ...]
    """`task_index` of its steps, each once, in order."""
    columns: Mapping[str, np.ndarray]
    """Those that were asked for, as stored, [T, N]."""


def read_rows(places: Sequence[EpisodePlace], names: Sequence[str]) -> Iterator[EpisodeRows]:
    """The numbers of episodes, in their order.

    Args:
        places: The episodes.
        names: Columns.

    Raises:
        DatasetError: A table is missing or damaged, lacks a column, or its rows are not those of
            the episodes that are said to be in it.
    """
    by_file: dict[Path, list[EpisodePlace]] = {}
    for place in places:
        by_file.setdefault(place.table, []).append(place)
    for path, inside in by_file.items():
        table = read_table(path, [*INDICES, *names])
        yield from _cut(path, table, inside, names)


def _cut(
    path: Path, table: pa.Table, places: Sequence[EpisodePlace], names: Sequence[str]
) -> Iterator[EpisodeRows]:
    arrays = {name: numbers(table, name, path) for name in [*INDICES, *names]}
    for name in INDICES:
        if arrays[name].shape[1] > 1:
            raise DatasetError(f"{path}: '{name}' has {arrays[name].shape[1]} numbers a row.")
    index = {name: arrays[name].reshape(-1) for name in INDICES}
    episode = index["episode_index"]
    starts = np.flatnonzero(np.diff(episode, prepend=episode[:1] - 1))
    first_of = dict(zip(episode[starts].tolist(), starts.tolist(), strict=True))
    length_of = dict(zip(episode[starts].tolist(), np.diff([*starts, len(episode)]), strict=True))
    if len(first_of) < len(starts):
        raise DatasetError(f"{path}: rows of one episode_index are not together.")
    if unknown := first_of.keys() - {place.number for place in places}:
        raise DatasetError(
            f"{path} has rows of episode {min(unknown)}, which meta does not place there."
        )
    for place in places:
        length = int(length_of.get(place.number, 0))
        if length != place.length:
            raise DatasetError(
                f"{path}: {place.name} has {length} rows, and meta says {place.length} steps."
            )
        first = first_of[place.number]
        own = slice(first, first + length)
        _check_indices(path, place, {name: values[own] for name, values in index.items()})
        tasks = tuple(dict.fromkeys(index["task_index"][own].tolist()))
        columns = {name: arrays[name][own] for name in names}
        times = index["timestamp"][own].astype(np.float64)
        yield EpisodeRows(place, first, times, tasks, columns)


def _check_indices(path: Path, place: EpisodePlace, index: Mapping[str, np.ndarray]) -> None:
    """Refuses rows that are not one step after the other."""
    steps, times = np.arange(place.length), index["timestamp"]
    if (index["frame_index"] != steps).any():
        step = int(np.argmax(index["frame_index"] != steps))
        raise DatasetError(
            f"{path}: {place.name} has the frame_index {index['frame_index'][step]} in its row "
            f"{step}; they count from 0."
        )
    if place.first is not None and (index["index"] != place.first + steps).any():
        raise DatasetError(
            f"{path}: the index of {place.name} counts from {index['index'][0]}, and meta says "
            f"{place.first} to {place.first + place.length - 1}."
        )
    if not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        raise DatasetError(f"{path}: the timestamps of {place.name} do not rise from row to row.")
