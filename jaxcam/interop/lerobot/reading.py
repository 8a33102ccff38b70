"""LeRobot datasets, versions 3.0 and 2.1, as recorded demonstrations.

Read with pyarrow and PyAV, so LeRobot and its PyTorch need not be installed. Nothing is written
into the folder. Numbers are read at once; of pictures only what tells that all are there.
"""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console

from jaxcam.console.progress import progress
from jaxcam.data.recorded.recording import Calibration, Episode, Placement, Recording, Sight
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.files.paths import absolute
from jaxcam.interop.cameras import six_numbers
from jaxcam.interop.lerobot.recorded.images import (
    ImageClip,
    ImageReader,
    check_images,
    identity_of_images,
)
from jaxcam.interop.lerobot.recorded.meta import (
    INFO,
    Info,
    held_out,
    read_episodes,
    read_info,
    read_tasks,
)
from jaxcam.interop.lerobot.recorded.naming import (
    ACTIONS,
    STATES,
    columns_of,
    constant,
    number_names,
    view_names,
)
from jaxcam.interop.lerobot.recorded.readers import Readers
from jaxcam.interop.lerobot.recorded.rows import EpisodeRows, read_episode_rows
from jaxcam.interop.lerobot.recorded.videos import (
    VideoClip,
    VideoReader,
    check_video,
    identity_of_video,
)
from jaxcam.rays.lens import PACKED

MATRICES = {"intrinsics": (3, 3), "base_from_camera": (4, 4), "distortion": (PACKED,)}
"""Columns `camera.<view>.<name>` of a calibration and their shapes; the last need not be there."""
ERRORS = "errors"
"""The column that says which actions err on purpose, where it is one of true and false."""
TOLERANCE = 0.1
"""What the time of a picture may be off, in steps."""

AnyClip = VideoClip | ImageClip


@dataclass(frozen=True)
class _Columns:
    """Which columns are what."""

    state: tuple[str, ...]
    action: tuple[str, ...]
    cameras: Mapping[str, Mapping[str, str]]
    """By view, those of `MATRICES` that it has."""
    extrinsics: Mapping[str, str]
    """By view, that of DROID's six numbers, where there is one."""
    errors: bool
    """Whether there is one of errors on purpose."""

    @property
    def all(self) -> list[str]:
        cameras = [name for columns in self.cameras.values() for name in columns.values()]
        cameras += self.extrinsics.values()
        errors = [ERRORS] if self.errors else []
        return list(dict.fromkeys([*self.state, *self.action, *cameras, *errors]))


def read_lerobot(
    path: str | Path,
    *,
    state: Sequence[str] = (),
    action: Sequence[str] = (),
    tolerance: float | None = None,
    console: Console | None = None,
) -> Recording:
    """Reads a LeRobot dataset.

    Cameras whose `camera.<view>.intrinsics` and `camera.<view>.base_from_camera` are among the
    columns, as `jaxcam.lerobot` writes them, are calibrated; the others are not, but for those with
    DROID's `camera_extrinsics.<view>` it is known where they stood. Depth is no view. Actions where
    the column `errors` is true are not imitated.

    The fingerprint is a hash of all numbers, names, instructions and calibrations, and of the files
    of pictures: their names in the folder, their sizes, and of a table of images all of its
    content, of a video its first and last 64 KiB (`identity_of_video` says why). That of the
    pictures is of these files alone, and of which picture belongs to which step.

    Args:
        path: The folder, which has `meta/info.json`.
        state: Features that are the state, one behind the other; `observation.state` when empty.
        action: Features that are the action; `action` when empty.
        tolerance: How far the time of a step's picture may be from the step's (s); a tenth of a
            step when None.
        console: For progress; silent when None.

    Returns:
        The recording. Its episodes' pictures are decoded when they are asked for.

    Raises:
        DatasetError: It is no such folder, one of another version, or damaged: numbers that are not
            finite, missing or short videos, codecs that cannot be decoded, steps without a picture.
            All of this is found at once; single damaged pictures are found as they are decoded.
        ConfigError: pyarrow is not installed, or the tolerance is no part of a step.
    """
    root = absolute(path)
    info, where = read_info(root), str(root / INFO)
    views = view_names(info.features, where)
    columns = _Columns(
        columns_of(info.features, state, STATES, where),
        columns_of(info.features, action, ACTIONS, where),
        {view: _camera_columns(info, view) for view in views},
        {v: c for v in views if (c := six_numbers.COLUMN.format(view=v)) in info.features},
        _has_errors(info),
    )
    allowed = _tolerance(tolerance, info)
    tasks, places = read_tasks(root, info), read_episodes(root, info)
    rows = sorted(read_episode_rows(places, columns.all), key=lambda episode: episode.place.number)
    names = [
        number_names(info.features, keys, [rows[0].columns[k].shape[1] for k in keys], where)
        for keys in (columns.state, columns.action)
    ]
    clips = [
        {v: c for v, key in views.items() if (c := _clip(info, episode, v, key, allowed))}
        for episode in rows
    ]
    numbers = [
        (_joined(episode, columns.state, names[0]), _joined(episode, columns.action, names[1]))
        for episode in rows
    ]
    sights = _sights(rows, clips, columns, _check_pictures(clips, console))
    recording = Recording(
        path=root,
        views=tuple(views),
        state_names=names[0],
        action_names=names[1],
        rate=float(info.fps),
        episodes=[
            Episode(e.place.name, *pair, _instruction(e, tasks), by_view, _errors(e))
            for e, pair, by_view in zip(rows, numbers, sights, strict=True)
        ],
        fingerprint="",
        valid=held_out(root, info, places),
    )
    return _sealed(recording, clips)


def _tolerance(asked: float | None, info: Info) -> float:
    """What the time of a picture may be off (s)."""
    allowed = TOLERANCE / info.fps if asked is None else asked
    if not 0 < allowed < 0.5 / info.fps:
        raise ConfigError(
            f"tolerance is more than 0 and less than half a step ({0.5 / info.fps:.4f} s), got "
            f"{allowed}."
        )
    return allowed


def _camera_columns(info: Info, view: str) -> dict[str, str]:
    """The columns of a view's calibration, by what they are; none if it is not whole."""
    names = {what: f"camera.{view}.{what}" for what in MATRICES}
    there = {what: name for what, name in names.items() if name in info.features}
    return there if {"intrinsics", "base_from_camera"} <= there.keys() else {}


def _has_errors(info: Info) -> bool:
    """Whether a column says which actions err; one of other numbers is somebody else's."""
    column = info.features.get(ERRORS)
    return column is not None and column.dtype == "bool" and column.shape in ((), (1,))


def _errors(rows: EpisodeRows) -> np.ndarray | None:
    """Which actions err on purpose, bool [T]; None if none does."""
    if ERRORS not in rows.columns:
        return None
    values, where = rows.columns[ERRORS], f"{rows.place.table}, {rows.place.name}"
    if values.shape[1] != 1 or not np.isin(values, (0, 1)).all():
        raise DatasetError(
            f"{where}: '{ERRORS}' is a column of {values.shape[1]} number(s) a step between "
            f"{values.min()} and {values.max()}, expected true or false, as meta/info.json says."
        )
    err = values[:, 0].astype(bool)
    if err.all():
        raise DatasetError(
            f"{where}: all {len(err)} steps are '{ERRORS}', so nothing is left to imitate. Leave "
            "the episode out."
        )
    return err if err.any() else None


def _clip(info: Info, rows: EpisodeRows, view: str, key: str, tolerance: float) -> AnyClip | None:
    """Where a camera's pictures of an episode are; None where it did not see it."""
    place = rows.place
    if info.features[key].dtype == "image":
        return ImageClip(view, place.table, key, rows.row, place.length, place.name)
    if key not in place.videos:
        return None
    file, start = place.videos[key]
    return VideoClip(view, file, start + rows.timestamps, tolerance, place.name)


def _check_pictures(
    clips: Sequence[Mapping[str, AnyClip]], console: Console | None
) -> dict[tuple[Path, str], tuple[int, int]]:
    """Height and width of every file's pictures, by file and view; refuses what cannot be read."""
    inside: dict[tuple[Path, str], list[AnyClip]] = {}
    for clip in (clip for views in clips for clip in views.values()):
        inside.setdefault((clip.file, clip.view), []).append(clip)
    sizes = {}
    with progress(console, "checking", len(inside)) as advance:
        for (file, view), of_file in inside.items():
            first = of_file[0]
            if isinstance(first, ImageClip):
                sizes[file, view] = check_images(first)
            else:
                own = [clip for clip in of_file if isinstance(clip, VideoClip)]
                sizes[file, view] = check_video(file, own)
            advance()
    return sizes


def _joined(rows: EpisodeRows, columns: Sequence[str], names: Sequence[str]) -> np.ndarray:
    """Columns side by side, float32 [T, N]."""
    with np.errstate(over="ignore"):  # what is too large becomes infinite, and is refused
        values = np.concatenate([rows.columns[c] for c in columns], 1).astype(np.float32)
    where = f"{rows.place.table}, {rows.place.name}"
    if values.shape[1] != len(names):
        raise DatasetError(
            f"{where}: {', '.join(columns)} has {values.shape[1]} numbers a step, {len(names)} in "
            "other files."
        )
    if not np.isfinite(values).all():
        step, i = np.argwhere(~np.isfinite(values))[0]
        raise DatasetError(
            f"{where}: '{names[i]}' of {', '.join(columns)} is {values[step, i]} in step {step}. "
            "Numbers must be finite: leave the episode out, or repair it."
        )
    return values


def _instruction(rows: EpisodeRows, tasks: Mapping[int, str]) -> str:
    """What was asked for; of steps with different tasks, one after the other."""
    if not tasks:
        return ""
    if unknown := [t for t in rows.tasks if t not in tasks]:
        raise DatasetError(
            f"{rows.place.table}: {rows.place.name} has the task_index {unknown[0]}, which meta's "
            "tasks lack."
        )
    return "; ".join(tasks[t] for t in rows.tasks)


def _sights(
    rows: Sequence[EpisodeRows],
    clips: Sequence[Mapping[str, AnyClip]],
    columns: _Columns,
    sizes: Mapping[tuple[Path, str], tuple[int, int]],
) -> Iterator[dict[str, Sight]]:
    """What the cameras saw of each episode."""
    films, albums = Readers(VideoReader), Readers(ImageReader)
    for episode, by_view in zip(rows, clips, strict=True):
        sights = {}
        for view, clip in by_view.items():
            size, camera = sizes[clip.file, view], columns.cameras[view]
            decode = partial(_sized, films if isinstance(clip, VideoClip) else albums, clip, size)
            calibration = _calibration(clip, episode, camera) if camera else None
            placement = _placement(episode, view, columns.extrinsics)
            sights[view] = Sight(*size, decode, calibration, placement)
        yield sights


def _placement(rows: EpisodeRows, view: str, extrinsics: Mapping[str, str]) -> Placement | None:
    """What the column of DROID's six numbers says; they were often never filled in."""
    if view not in extrinsics:
        return None
    name = extrinsics[view]
    where = f"{rows.place.table}, {rows.place.name}: '{name}'"
    return six_numbers.placement_of(rows.columns[name], where, f"the column {name}")


def _sized(readers: Readers, clip: AnyClip, size: tuple[int, int]) -> Iterator[np.ndarray]:
    """A clip's pictures, which all have one size."""
    for step, shown in enumerate(readers.decode(clip)):
        if shown.shape[:2] != size:
            raise DatasetError(
                f"{clip.about}: the picture of step {step} has {shown.shape[1]}x{shown.shape[0]} "
                f"pixels, others of the file {size[1]}x{size[0]}."
            )
        yield shown


def _calibration(clip: AnyClip, rows: EpisodeRows, columns: Mapping[str, str]) -> Calibration:
    """What the columns of a camera say; what stays the same through an episode is kept once."""
    values = {}
    for what, name in columns.items():
        shape, column = MATRICES[what], rows.columns[name].astype(np.float64)
        if column.shape[1] != np.prod(shape) or not np.isfinite(column).all():
            raise DatasetError(
                f"{rows.place.table}, {rows.place.name}: '{name}' are {list(shape)} finite numbers "
                f"a step, got {column[0]}."
            )
        values[what] = constant(column.reshape(-1, *shape))
    return Calibration(
        K=values["intrinsics"],
        base_from_camera=values["base_from_camera"],
        distortion=constant(values.get("distortion", np.zeros((1, PACKED)))),
        source=f"the columns camera.{clip.view}.*",
    )


def _sealed(recording: Recording, clips: Sequence[Mapping[str, AnyClip]]) -> Recording:
    """The recording with its fingerprints: 16 hex digits each, see `read_lerobot`."""
    whole, pictures = _Seal(), _Seal()
    known: dict[Path, bytes] = {}  # identities of files
    whole.add(recording.views, recording.state_names, recording.action_names)
    whole.add(recording.rate, recording.valid)
    for episode, by_view in zip(recording.episodes, clips, strict=True):
        whole.add(episode.instruction, episode.state, episode.action)
        if episode.errors is not None:
            whole.add(episode.errors)
        pictures.add(len(by_view))
        for view, clip in by_view.items():
            file, camera = clip.file, episode.sights[view].calibration
            if file not in known:
                known[file] = _identity(clip)
            place = clip.first if isinstance(clip, ImageClip) else clip.times
            shown = (view, str(file.relative_to(recording.path)), known[file], place)
            whole.add(*shown)
            pictures.add(*shown, episode.length)
            if camera is not None:
                whole.add(camera.K, camera.base_from_camera, camera.distortion)
    return replace(recording, fingerprint=whole.text, pictures=pictures.text)


class _Seal:
    """A hash of values, one after the other."""

    def __init__(self) -> None:
        self._digest = hashlib.sha256()

    def add(self, *values: object) -> None:
        """Goes on with values."""
        for value in values:
            data = value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode()
            self._digest.update(len(data).to_bytes(8, "little") + data)

    @property
    def text(self) -> str:
        """16 hex digits."""
        return self._digest.hexdigest()[:16]


def _identity(clip: AnyClip) -> bytes:
    """What tells a clip's file from another."""
    if isinstance(clip, ImageClip):
        return identity_of_images(clip.file)
    return identity_of_video(clip.file)
