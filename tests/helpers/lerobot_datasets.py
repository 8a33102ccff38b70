"""Small LeRobot datasets, written as LeRobot writes them, and spoilt ones."""

import contextlib
import json
import os
from dataclasses import dataclass, field
from pathlib import Path

import av
import cv2
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from jaxcam.errors import DatasetError
from jaxcam.interop.lerobot.reading import read_lerobot

HEIGHT, WIDTH, RATE = 48, 64, 20
LENGTHS = (6, 4, 9)
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
TOP = "observation.images.top"
TASKS = ("Pick the cup up.", "Put the cup down.")
VERSIONS = ("v3.0", "v2.1")
_EPISODE = "episode_{episode_index:06d}"
PATHS = {
    "v3.0": {
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
    },
    "v2.1": {
        "data_path": f"data/chunk-{{episode_chunk:03d}}/{_EPISODE}.parquet",
        "video_path": f"videos/chunk-{{episode_chunk:03d}}/{{video_key}}/{_EPISODE}.mp4",
    },
}


def picture(episode, step, view):
    """A picture that says whose it is: its brightness counts steps, its right half episodes."""
    shown = np.full((HEIGHT, WIDTH, 3), 20 + 20 * step, np.uint8)
    shown[:, WIDTH // 2 :] = 40 + 60 * episode
    shown[: HEIGHT // 2, : WIDTH // 4] = 60 + 80 * view
    return shown


@dataclass
class Written:
    """What a folder was written from, in the order of its episodes."""

    states: list = field(default_factory=list)
    actions: list = field(default_factory=list)
    pictures: dict = field(default_factory=dict)
    tasks: list = field(default_factory=list)


def write_folder(
    root,
    version="v3.0",
    dtype="video",
    *,
    codec="libx264",
    keys=("observation.images.top", "observation.images.wrist"),
    options=None,
    start=0.0,
):
    """Writes a dataset of `LENGTHS`; of v3.0 the first two episodes share files.

    Args:
        root: Folder, new.
        version: Of the format.
        dtype: What pictures are, "video" or "image".
        codec: Of the videos, PyAV's name.
        keys: Features that are pictures.
        options: Of the codec.
        start: Seconds before each video's first picture.

    Returns:
        What it was written from.
    """
    rng, made = np.random.default_rng(0), Written(pictures={key: [] for key in keys})
    tables, clips, index = [], {key: [] for key in keys}, 0
    for e, length in enumerate(LENGTHS):
        state = rng.normal(size=(length, 3)).astype(np.float32)
        action = rng.normal(size=(length, 2)).astype(np.float32)
        made.states.append(state)
        made.actions.append(action)
        made.tasks.append(TASKS[e % 2])
        columns = {
            "observation.state": list(state),
            "action": list(action),
            "timestamp": pa.array(np.arange(length, dtype=np.float32) / RATE),
            "frame_index": np.arange(length),
            "episode_index": np.full(length, e),
            "index": index + np.arange(length),
            "task_index": np.full(length, e % 2),
        }
        for v, key in enumerate(keys):
            shown = [picture(e, t, v) for t in range(length)]
            made.pictures[key].append(shown)
            clips[key].append(shown)
            if dtype == "image":
                kind = pa.struct({"bytes": pa.binary(), "path": pa.string()})
                files = [{"bytes": _png(p), "path": f"frame_{t}.png"} for t, p in enumerate(shown)]
                columns[key] = pa.array(files, kind)
        tables.append(pa.table(columns))
        index += length
    # file of each episode, and the episodes before it there
    files = [(e, 0) for e in range(len(LENGTHS))]
    if version == "v3.0":
        files = [(0, 0), (0, 1), *files[1:-1]]
    _write_tables(root, version, files, tables)
    if dtype == "video":
        for key in keys:
            _write_videos(root, version, files, clips[key], key, codec, options or {}, start)
    _write_meta(root, version, dtype, files, keys, start)
    return made


def edit_info(root, **changes):
    """Changes values of `meta/info.json`; what becomes None is taken out."""
    path = root / "meta/info.json"
    info = json.loads(path.read_text()) | changes
    path.write_text(json.dumps({k: v for k, v in info.items() if v is not None}))


def edit_feature(root, name, **changes):
    """Changes what `meta/info.json` says of a feature."""
    features = json.loads((root / "meta/info.json").read_text())["features"]
    features[name] = features.get(name, {}) | changes
    edit_info(root, features=features)


def edit_table(path, **columns):
    """Puts other columns into a table; what becomes None is taken out."""
    table = parquet.read_table(path)
    for name, values in columns.items():
        if name in table.column_names:
            table = table.drop_columns([name])
        if values is not None:
            table = table.append_column(name, pa.array(values))
    parquet.write_table(table, path)


def data_file(root):
    """The first table of rows."""
    return min((root / "data").rglob("*.parquet"))


def video_file(root):
    """The first video."""
    return min((root / "videos").rglob("*.mp4"))


def _png(shown):
    return cv2.imencode(".png", cv2.cvtColor(shown, cv2.COLOR_RGB2BGR))[1].tobytes()


def _path(root, pattern, file, **values):
    numbers = {"chunk_index": 0, "file_index": file, "episode_chunk": 0, "episode_index": file}
    path = root / pattern.format(**numbers, **values)
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _write_tables(root, version, files, tables):
    for file in sorted({f for f, _ in files}):
        own = [table for table, (f, _) in zip(tables, files, strict=True) if f == file]
        path = _path(root, PATHS[version]["data_path"], file)
        parquet.write_table(pa.concat_tables(own), path, row_group_size=7)


def _write_videos(root, version, files, clips, key, codec, options, start):
    for file in sorted({f for f, _ in files}):
        shown = [p for clip, (f, _) in zip(clips, files, strict=True) if f == file for p in clip]
        path = _path(root, PATHS[version]["video_path"], file, video_key=key)
        write_mp4(path, shown, codec, options, start)


def write_mp4(path, pictures, codec="libx264", options=None, start=0.0, rate=RATE, moments=None):
    """Writes a video, its index first; pictures are one after the other, or at these moments."""
    quiet = {"libx265": {"x265-params": "log-level=none"}, "libsvtav1": {"crf": "30"}}
    faststart = {"movflags": "faststart"}
    with (
        _usual_priority(),
        av.open(str(path), "w", format="mp4", options=faststart) as container,
    ):
        settings = quiet.get(codec, {"crf": "10"}) | (options or {})
        stream = container.add_stream(codec, rate=rate, options=settings)
        stream.height, stream.width, stream.pix_fmt = HEIGHT, WIDTH, "yuv420p"
        moments = range(len(pictures)) if moments is None else moments
        for i, shown in zip(moments, pictures, strict=True):
            frame = av.VideoFrame.from_ndarray(shown, format="rgb24")
            frame.time_base, frame.pts = (
                1 / stream.codec_context.framerate,
                int(i) + round(start * rate),
            )
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


@contextlib.contextmanager
def _usual_priority():
    """SVT-AV1 makes a thread of root's a real-time one, and leaves it so: children, which inherit
    that, would wait for each other without end."""
    if not hasattr(os, "sched_getscheduler"):
        yield
        return
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        yield
    finally:
        os.sched_setscheduler(0, *before)


def _write_meta(root, version, dtype, files, keys, start):
    (root / "meta").mkdir()
    scalar = {name: {"dtype": "int64", "shape": [1], "names": None} for name in (
        "frame_index", "episode_index", "index", "task_index")}  # fmt: skip
    features = {
        "observation.state": {"dtype": "float32", "shape": [3], "names": ["a", "b", "c"]},
        "action": {"dtype": "float32", "shape": [2], "names": {"motors": ["x", "y"]}},
        "timestamp": {"dtype": "float32", "shape": [1], "names": None},
        **scalar,
    }
    names = ["height", "width", "channels"]
    features |= {k: {"dtype": dtype, "shape": [HEIGHT, WIDTH, 3], "names": names} for k in keys}
    info = {
        "codebase_version": version,
        "robot_type": "none",
        "total_episodes": len(LENGTHS),
        "total_frames": sum(LENGTHS),
        "total_tasks": len(TASKS),
        "total_videos": len(keys) * len(LENGTHS),
        "total_chunks": 1,
        "chunks_size": 1000,
        "fps": RATE,
        "splits": {"train": f"0:{len(LENGTHS)}"},
        "features": features,
        **PATHS[version],
    }
    (root / "meta/info.json").write_text(json.dumps(info))
    starts = np.cumsum([0, *LENGTHS])
    if version == "v2.1":
        _write_lines(root / "meta/tasks.jsonl", [
            {"task_index": i, "task": task} for i, task in enumerate(TASKS)])  # fmt: skip
        _write_lines(root / "meta/episodes.jsonl", [
            {"episode_index": e, "tasks": [TASKS[e % 2]], "length": n}
            for e, n in enumerate(LENGTHS)])  # fmt: skip
        return
    tasks = pa.table({"task_index": [0, 1], "__index_level_0__": list(TASKS)})
    parquet.write_table(tasks, root / "meta/tasks.parquet")
    rows = []
    for e, length in enumerate(LENGTHS):
        file, place = files[e]
        before = sum(LENGTHS[e - place : e])
        row = {
            "episode_index": e,
            "tasks": [TASKS[e % 2]],
            "length": length,
            "data/chunk_index": 0,
            "data/file_index": file,
            "dataset_from_index": int(starts[e]),
            "dataset_to_index": int(starts[e + 1]),
        }
        for key in keys if dtype == "video" else ():
            row |= {f"videos/{key}/chunk_index": 0, f"videos/{key}/file_index": file}
            row[f"videos/{key}/from_timestamp"] = start + before / RATE
            row[f"videos/{key}/to_timestamp"] = start + (before + length) / RATE
        rows.append(row)
    path = root / "meta/episodes/chunk-000/file-000.parquet"
    path.parent.mkdir(parents=True)
    parquet.write_table(pa.Table.from_pylist(rows), path)


def _write_lines(path: Path, rows):
    path.write_text("\n".join(json.dumps(row) for row in rows))  # the last line has no end


def shown(episode, view="top"):
    return np.stack(list(episode.sights[view].decode()))


def psnr(a, b):
    error = np.mean((a.astype(float) - b) ** 2)
    return 10 * np.log10(255**2 / error) if error else np.inf


def check_pictures(recording, made, least=35.0):
    for e, episode in enumerate(recording.episodes):
        for view, key in zip(recording.views, made.pictures, strict=True):
            decoded, wanted = shown(episode, view), np.stack(made.pictures[key][e])
            assert decoded.shape == wanted.shape
            assert decoded.dtype == np.uint8
            assert psnr(decoded, wanted) >= least


def refused(root, match, **asked):
    """Reading ends in one line, before any episode is decoded."""
    with pytest.raises(DatasetError, match=match) as caught:
        read_lerobot(root, **asked)
    assert "\n" not in str(caught.value)
    return str(caught.value)
