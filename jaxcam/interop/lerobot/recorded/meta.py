"""What a LeRobot folder says of itself: features, tasks and where each episode is.

Versions 3.0 and 2.1 (LeRobot 0.2 to 0.6) come out as one. Of 3.0 `format` has the layout; 2.1 has
JSON lines instead of tables in `meta`, and a table and a video of its own for each episode::

    meta/info.json, tasks.jsonl, episodes.jsonl
    data/chunk-000/episode_000000.parquet
    videos/chunk-000/<feature>/episode_000000.mp4

Statistics are not read, so they may be missing.
"""

import contextlib
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path, PurePosixPath
from typing import Any

from jaxcam.config.fields import as_record, short
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.files.json import read_json
from jaxcam.files.jsonl import read_jsonl
from jaxcam.interop.lerobot.format import CHUNK, VERSION
from jaxcam.interop.lerobot.recorded.tables import read_table, texts, whole_numbers

OLD_VERSION = "v2.1"
"""The version with a file an episode."""
MIGRATIONS = {
    "v2.0": "lerobot/common/datasets/v21/convert_dataset_v20_to_v21.py of LeRobot 0.1",
    "v1": "lerobot/common/datasets/v2/convert_dataset_v1_to_v2.py of LeRobot's tag v2.0",
}
"""What of LeRobot's brings older folders on, by the start of their version."""
INFO = "meta/info.json"
_FIELD = re.compile(r"\{(\w+)(?::0?(\d)d)?\}")
_PICTURES = ("video", "image")
_VALID = ("val", "valid", "validation", "test")


@dataclass(frozen=True)
class FeatureInfo:
    """A column, a video or images."""

    dtype: str
    """Of its numbers; `video` and `image` are pictures."""
    shape: tuple[int, ...] = ()
    names: Any = None
    """Of its numbers or axes: a list, or lists in a dict."""
    info: dict[str, Any] | None = None
    """Of pictures: how they are coded."""
    video_info: dict[str, Any] | None = None
    """The same, as older versions call it."""

    @property
    def is_picture(self) -> bool:
        """Whether it is what a camera saw in colours; depth is none."""
        about = (self.video_info or {}) | (self.info or {})
        is_depth = about.get("is_depth_map") or about.get("video.is_depth_map")
        return self.dtype in _PICTURES and not is_depth


@dataclass(frozen=True)
class Info:
    """What `meta/info.json` says, as far as it is needed here."""

    codebase_version: str
    fps: float
    features: dict[str, FeatureInfo]
    total_episodes: int
    data_path: str
    total_tasks: int = 0
    chunks_size: int = CHUNK
    video_path: str | None = None
    splits: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class EpisodePlace:
    """Where an episode is."""

    number: int
    """`episode_index` of its rows."""
    length: int
    """Steps."""
    table: Path
    """The file of its rows."""
    first: int | None
    """`index` of its first row, where that is said."""
    videos: Mapping[str, tuple[Path, float]]
    """Of each feature that is a video: the file, and the time in it (s) at which it begins."""

    @property
    def name(self) -> str:
        """For messages."""
        return f"episode {self.number}"


@dataclass(frozen=True)
class _Line:
    """A row of `meta/episodes.jsonl`."""

    episode_index: int
    length: int


@dataclass(frozen=True)
class _Task:
    """A row of `meta/tasks.jsonl`."""

    task_index: int
    task: str


def read_info(root: Path) -> Info:
    """What `meta/info.json` says.

    Args:
        root: The folder.

    Raises:
        DatasetError: It is no LeRobot folder, one of another version, or says what cannot be.
    """
    path = root / INFO
    if not path.is_file():
        if (root / "meta_data/info.json").is_file():
            raise DatasetError(_of_version(root, "v1"))
        raise DatasetError(f"{root} is no LeRobot dataset: it has no {INFO}.")
    content = read_json(path)
    if not isinstance(content, dict):
        raise DatasetError(f"{path} is a JSON {type(content).__name__}, not an object.")
    version = content.get("codebase_version")
    if version not in (VERSION, OLD_VERSION):
        raise DatasetError(_of_version(root, version))
    with _blaming(path):
        content["features"] = _features(content.get("features"))
        info = as_record(Info, _known(Info, content), INFO)
    if not 0 < info.fps < math.inf or info.chunks_size < 1:
        raise DatasetError(
            f"{path}: fps and chunks_size are more than 0, got {info.fps} and {info.chunks_size}."
        )
    return info


def _features(content: Any) -> dict[str, FeatureInfo]:
    if not isinstance(content, dict):
        raise ConfigError(f"features are names with what each one is, got {short(content)}.")
    return {
        name: as_record(FeatureInfo, _known(FeatureInfo, values), f"feature '{name}'")
        for name, values in content.items()
    }


def _of_version(root: Path, version: Any) -> str:
    """The message for a version that is not read."""
    start = f"{root} is in the format {short(version)}; {VERSION} and {OLD_VERSION} are read."
    numbers = re.fullmatch(r"v(\d{1,4})(?:\.(\d{1,4}))?", str(version))
    if numbers is None:
        return start
    if (int(numbers[1]), int(numbers[2] or 0)) > (3, 0):
        return f"{start} A newer LeRobot wrote it: look for a newer jaxcam."
    script = next((s for v, s in MIGRATIONS.items() if str(version).startswith(v)), None)
    return f"{start} Bring it on with {script}." if script else start


def _known(kind: type, values: Any) -> Any:
    """Those of a JSON object's values that a record has a place for: others may add more."""
    if not isinstance(values, dict):
        return values
    names = {f.name for f in fields(kind)}
    return {name: value for name, value in values.items() if name in names}


@contextlib.contextmanager
def _blaming(path: Path) -> Iterator[None]:
    """Says in which file a value is of the wrong kind."""
    try:
        yield
    except ConfigError as error:
        raise DatasetError(f"{path}: {error}") from error


def read_tasks(root: Path, info: Info) -> dict[int, str]:
    """The instructions, by `task_index`.

    Raises:
        DatasetError: The file is missing or damaged.
    """
    old = info.codebase_version == OLD_VERSION
    path = root / ("meta/tasks.jsonl" if old else "meta/tasks.parquet")
    if not path.exists() and not info.total_tasks:
        return {}
    if old:
        rows = _lines(path, _Task)
        return {row.task_index: row.task for row in rows}
    # pandas wrote it, with the instructions as an index, which may have no name
    table = read_table(path)
    words = "task" if "task" in table.column_names else "__index_level_0__"
    numbers = whole_numbers(table, "task_index", path)
    return dict(zip(numbers, texts(table, words, path), strict=True))


def read_episodes(root: Path, info: Info) -> list[EpisodePlace]:
    """Where each episode is, in order of their numbers.

    Raises:
        DatasetError: The files are missing or damaged, or say what cannot be.
    """
    old = info.codebase_version == OLD_VERSION
    places = list(_old_places(root, info) if old else _new_places(root, info))
    places.sort(key=lambda place: place.number)
    numbers = [place.number for place in places]
    if len(set(numbers)) < len(numbers):
        twice = next(n for n in numbers if numbers.count(n) > 1)
        raise DatasetError(f"{root}/meta: episode {twice} is listed twice.")
    if len(places) != info.total_episodes or not places:
        raise DatasetError(
            f"{root}: {INFO} says {info.total_episodes} episodes, and its lists have {len(places)}."
        )
    if short_ones := [place for place in places if place.length < 1]:
        raise DatasetError(f"{root}/meta: {short_ones[0].name} has {short_ones[0].length} steps.")
    return places


def _old_places(root: Path, info: Info) -> Iterator[EpisodePlace]:
    videos = [k for k, f in info.features.items() if f.is_picture and f.dtype == "video"]
    for row in _lines(root / "meta/episodes.jsonl", _Line):
        e = row.episode_index
        numbers: dict[str, Any] = {"episode_chunk": e // info.chunks_size, "episode_index": e}
        files = {k: _video(root, info, video_key=k, **numbers) for k in videos}
        table = path_in(root, info.data_path, numbers)
        yield EpisodePlace(e, row.length, table, None, {k: (f, 0.0) for k, f in files.items()})


def _new_places(root: Path, info: Info) -> Iterator[EpisodePlace]:
    paths = sorted((root / "meta/episodes").glob("*/*.parquet"))
    if not paths:
        raise DatasetError(f"{root} has no table of its episodes, meta/episodes/*/*.parquet.")
    videos = [k for k, f in info.features.items() if f.is_picture and f.dtype == "video"]
    keys = ("chunk_index", "file_index", "from_timestamp")
    own = ("episode_index", "length", "data/chunk_index", "data/file_index")
    own += ("dataset_from_index", "dataset_to_index")
    names = [*own, *(f"videos/{video}/{key}" for video in videos for key in keys)]
    for path in paths:
        table = read_table(path, names)
        columns = [whole_numbers(table, name, path) for name in own]
        starts: dict[str, list[tuple[Path, float] | None]] = {}
        for video in videos:
            chunks, files, times = (table.column(f"videos/{video}/{k}").to_pylist() for k in keys)
            starts[video] = [
                _start(root, info, video, path, given)
                for given in zip(chunks, files, times, strict=True)
            ]
        for i, (e, length, chunk, file, first, end) in enumerate(zip(*columns, strict=True)):
            if end - first != length:
                raise DatasetError(
                    f"{path}: episode {e} has {length} steps, and the indices {first} to {end}."
                )
            numbers = {"chunk_index": chunk, "file_index": file}
            given = {video: start[i] for video, start in starts.items()}
            yield EpisodePlace(
                number=e,
                length=length,
                table=path_in(root, info.data_path, numbers),
                first=first,
                videos={video: start for video, start in given.items() if start is not None},
            )


def _start(
    root: Path, info: Info, video: str, path: Path, given: tuple[Any, Any, Any]
) -> tuple[Path, float] | None:
    """Where an episode begins in a video; None where the camera did not see it."""
    if given == (None, None, None):
        return None
    chunk, file, time = given
    is_time = isinstance(time, int | float) and math.isfinite(time)
    if not (type(chunk) is int and type(file) is int and is_time):
        raise DatasetError(
            f"{path}: where videos/{video} begin is two whole numbers and a time, got {given}."
        )
    return _video(root, info, video_key=video, chunk_index=chunk, file_index=file), float(time)


def _video(root: Path, info: Info, **values: Any) -> Path:
    if info.video_path is None:
        raise DatasetError(f"{root / INFO} has videos among its features, and no video_path.")
    return path_in(root, info.video_path, values)


def path_in(root: Path, pattern: str, values: Mapping[str, Any]) -> Path:
    """The file that a pattern of `meta/info.json` names, which lies in the folder.

    Args:
        root: The folder.
        pattern: A relative path with fields such as `{chunk_index:03d}`.
        values: Of the fields.

    Raises:
        DatasetError: It has another field, or leads out of the folder.
    """

    def fill(match: re.Match[str]) -> str:
        value = values.get(match[1])
        if value is None or (match[2] and not isinstance(value, int)):
            raise DatasetError(f"{root / INFO}: no {match[0]} is known in {short(pattern)}.")
        return f"{value:0{match[2]}d}" if match[2] else str(value)

    if re.search(r"[{}]", _FIELD.sub("", pattern)):
        raise DatasetError(f"{root / INFO}: {short(pattern)} has braces around what is no field.")
    path = PurePosixPath(_FIELD.sub(fill, pattern))
    if path.is_absolute() or ".." in path.parts:
        raise DatasetError(f"{root / INFO}: {short(str(path))} leads out of the folder.")
    return root / path


def held_out(root: Path, info: Info, places: list[EpisodePlace]) -> tuple[int, ...]:
    """Which of the episodes, counted from 0, the dataset itself holds out.

    Raises:
        DatasetError: A split is no range of its episodes.
    """
    chosen: set[int] = set()
    for name, text in info.splits.items():
        ends = re.fullmatch(r"\s*(\d{1,9}):(\d{1,9})\s*", text)
        if name not in _VALID:
            continue
        if ends is None or int(ends[2]) > len(places):
            raise DatasetError(
                f"{root / INFO}: the split '{name}' is {short(text)}, which is no range of its "
                f"{len(places)} episodes, such as 0:{len(places)}."
            )
        chosen |= set(range(int(ends[1]), int(ends[2])))
    return tuple(sorted(chosen))


def _lines(path: Path, kind: type[Any]) -> list[Any]:
    """The rows of a file of JSON lines as records."""
    if not path.is_file():
        raise DatasetError(f"{path} is missing.")
    rows = read_jsonl(path, may_be_torn=False)
    with _blaming(path):
        return [as_record(kind, _known(kind, row), f"row {i}") for i, row in enumerate(rows, 1)]
