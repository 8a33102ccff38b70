"""LeRobot's dataset format v3.0 on disk, written with pyarrow and PyAV.

Layout (LeRobot 0.4 to 0.6, `src/lerobot/datasets`)::

    meta/info.json                              what the dataset has
    meta/stats.json                             statistics of every feature
    meta/tasks.parquet                          tasks in words, the index of the table
    meta/episodes/chunk-000/file-000.parquet    where each episode's rows and videos are
    data/chunk-000/file-000.parquet             rows of many episodes, a row group each
    videos/<feature>/chunk-000/file-000.mp4     pictures of many episodes, in a row
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxcam.files.video import VideoFile
from jaxcam.interop.lerobot.arrow import pa, parquet

VERSION = "v3.0"
"""LeRobot's name of the format."""
CHUNK, DATA_MB, VIDEO_MB = 1000, 100, 200
"""Files a folder, and sizes of a file after which another one is begun (LeRobot's defaults)."""
_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
DATA, VIDEO = f"data/{_FILE}.parquet", f"videos/{{video_key}}/{_FILE}.mp4"
EPISODES = f"meta/episodes/{_FILE}.parquet"
CRF, KEY_EVERY = 18, 2
"""Quality of the videos, and pictures from one that stands alone to the next: any one is decoded
from at most two, as loaders that draw at random need."""
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

Stats = dict[str, np.ndarray]


def feature(dtype: str, shape: tuple[int, ...], names: list[str] | None = None) -> dict[str, Any]:
    """LeRobot's description of a column."""
    return {"dtype": dtype, "shape": list(shape), "names": names}


def video_feature(side: int, fps: int) -> dict[str, Any]:
    """LeRobot's description of a square video."""
    info = {
        "video.height": side,
        "video.width": side,
        "video.codec": "h264",
        "video.pix_fmt": "yuv420p",
        "video.is_depth_map": False,
        "video.fps": fps,
        "video.channels": 3,
        "has_audio": False,
    }
    return {**feature("video", (side, side, 3), ["height", "width", "channels"]), "info": info}


def write_json(path: Path, content: Any) -> None:
    """Writes readable JSON; folders are made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=4) + "\n")


class Writer:
    """Writes episodes one after another: their rows, their videos, and what finds them again.

    Args:
        root: Folder, new.
        features: Description of the columns and videos; LeRobot's own columns are added.
        fps: Pictures a second.
        task: Of every episode, in words.
    """

    def __init__(self, root: Path, features: dict[str, Any], fps: int, task: str) -> None:
        own = {"timestamp": feature("float32", (1,))}
        for name in ("frame_index", "episode_index", "index", "task_index"):
            own[name] = feature("int64", (1,))
        self._root, self._fps, self._task = root, fps, task
        self._features = {**features, **own}
        self._length = 0
        self._episodes: list[dict[str, Any]] = []
        self._rows: list[dict[str, np.ndarray]] = []
        self._shades: dict[str, np.ndarray] = {}
        self._data = _Numbered(root / DATA)
        self._table: parquet.ParquetWriter | None = None
        self._video_files: dict[str, _Numbered] = {}
        self._videos: dict[str, VideoFile] = {}

    def __enter__(self) -> "Writer":
        return self

    def __exit__(self, *exc: object) -> None:
        self._close_table()
        for key in list(self._videos):
            self._videos.pop(key).__exit__(*exc)

    def add(self, rows: dict[str, np.ndarray], videos: dict[str, np.ndarray]) -> None:
        """Appends an episode.

        Args:
            rows: Columns [T, ...].
            videos: Pictures, uint8 [T, H, W, 3].
        """
        length, episode = len(next(iter(rows.values()))), len(self._episodes)
        t = np.arange(length)
        rows = {
            **rows,
            "timestamp": (t / self._fps).astype(np.float32),
            "frame_index": t,
            "episode_index": np.full(length, episode),
            "index": self._length + t,
            "task_index": np.zeros(length, int),
        }
        about = {
            "episode_index": episode,
            "tasks": [self._task],
            "length": length,
            "dataset_from_index": self._length,
            "dataset_to_index": self._length + length,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
        about |= self._add_rows(rows)
        for key, pictures in videos.items():
            about |= self._add_pictures(key, pictures)
        stats = {key: stats_of(values) for key, values in rows.items()}
        for key, pictures in videos.items():
            shades = _shades(pictures)
            stats[key] = _stats_of_shades(shades, length)
            self._shades[key] = self._shades.get(key, 0) + shades
        for key, by_name in stats.items():
            about |= {f"stats/{key}/{name}": value.tolist() for name, value in by_name.items()}
        self._episodes.append(about)
        self._rows.append(rows)
        self._length += length

    def finish(self, robot_type: str) -> None:
        """Closes all files and writes the metadata."""
        self.__exit__(None, None, None)
        path = self._root / EPISODES.format(chunk_index=0, file_index=0)
        path.parent.mkdir(parents=True)
        parquet.write_table(pa.Table.from_pylist(self._episodes), path)
        _write_tasks(self._root / "meta/tasks.parquet", self._task)
        stats = {k: stats_of(np.concatenate([r[k] for r in self._rows])) for k in self._rows[0]}
        stats |= {k: _stats_of_shades(s, self._length) for k, s in self._shades.items()}
        listed = {k: {n: v.tolist() for n, v in by_name.items()} for k, by_name in stats.items()}
        write_json(self._root / "meta/stats.json", listed)
        info = {
            "codebase_version": VERSION,
            "robot_type": robot_type,
            "total_episodes": len(self._episodes),
            "total_frames": self._length,
            "total_tasks": 1,
            "chunks_size": CHUNK,
            "data_files_size_in_mb": DATA_MB,
            "video_files_size_in_mb": VIDEO_MB,
            "fps": self._fps,
            "splits": {"train": f"0:{len(self._episodes)}"},
            "data_path": DATA,
            "video_path": VIDEO,
            "features": self._features,
        }
        write_json(self._root / "meta/info.json", info)

    def _add_rows(self, rows: dict[str, np.ndarray]) -> dict[str, int]:
        table = pa.table({key: column_of(values) for key, values in rows.items()})
        if self._table is None:
            self._table = parquet.ParquetWriter(self._data.new_path(), table.schema)
        self._table.write_table(table)  # a row group an episode
        place = {"data/chunk_index": self._data.chunk, "data/file_index": self._data.file}
        if self._data.path.stat().st_size > DATA_MB * 2**20:
            self._close_table()
        return place

    def _close_table(self) -> None:
        if self._table is not None:
            self._table.close()
            self._table = None

    def _add_pictures(self, key: str, pictures: np.ndarray) -> dict[str, Any]:
        if key not in self._videos:
            pattern = self._root / VIDEO.replace("{video_key}", key)
            number = self._video_files.setdefault(key, _Numbered(pattern))
            self._videos[key] = VideoFile(
                number.new_path(),
                pictures.shape[1],
                pictures.shape[2],
                self._fps,
                crf=CRF,
                key_every=KEY_EVERY,
            )
        video, number = self._videos[key], self._video_files[key]
        first = video.length
        video.add(pictures)
        if video.part.stat().st_size > VIDEO_MB * 2**20:
            self._videos.pop(key).__exit__(None)
        return {
            f"videos/{key}/chunk_index": number.chunk,
            f"videos/{key}/file_index": number.file,
            f"videos/{key}/from_timestamp": first / self._fps,
            f"videos/{key}/to_timestamp": (first + len(pictures)) / self._fps,
        }


@dataclass
class _Numbered:
    """The files of one kind, numbered by a pattern of chunk and file."""

    pattern: Path
    number: int = -1

    @property
    def chunk(self) -> int:
        return self.number // CHUNK

    @property
    def file(self) -> int:
        return self.number % CHUNK

    @property
    def path(self) -> Path:
        return Path(str(self.pattern).format(chunk_index=self.chunk, file_index=self.file))

    def new_path(self) -> Path:
        self.number += 1
        self.path.parent.mkdir(parents=True, exist_ok=True)
        return self.path


def column_of(values: np.ndarray) -> pa.Array:
    """An Arrow array [T] of lists, as deep as the values' other axes."""
    flat = pa.array(np.ascontiguousarray(values).reshape(-1))
    for size in reversed(values.shape[1:]):
        flat = pa.ListArray.from_arrays(np.arange(0, len(flat) + 1, size, dtype=np.int32), flat)
    return flat


def stats_of(values: np.ndarray) -> Stats:
    """LeRobot's statistics over the first axis; a scalar column gives arrays of one number."""
    values = values[:, None] if values.ndim == 1 else values
    values = values.astype(float)
    found = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0)}
    found |= {"std": values.std(0), "count": np.array([len(values)])}
    return found | {name: np.quantile(values, q, 0) for name, q in QUANTILES.items()}


def _shades(pictures: np.ndarray) -> np.ndarray:
    """How often each of 256 values occurs in each channel [3, 256]."""
    return np.stack([np.bincount(pictures[..., c].reshape(-1), minlength=256) for c in range(3)])


def _stats_of_shades(shades: np.ndarray, count: int) -> Stats:
    """LeRobot's statistics of pictures, in [0, 1] and of shape [3, 1, 1]."""
    levels, total = np.arange(256) / 255, shades.sum(1)
    mean = shades @ levels / total
    there = shades > 0
    found = {
        "min": levels[there.argmax(1)],
        "max": levels[255 - there[:, ::-1].argmax(1)],
        "mean": mean,
        "std": np.sqrt(np.maximum(shades @ levels**2 / total - mean**2, 0)),
    }
    below = np.cumsum(shades, 1) / total[:, None]
    found |= {name: levels[(below >= q).argmax(1)] for name, q in QUANTILES.items()}
    return {k: v.reshape(3, 1, 1) for k, v in found.items()} | {"count": np.array([count])}


def _write_tasks(path: Path, task: str) -> None:
    """A table that pandas opens with the task's words as its index, which LeRobot looks up."""
    text = {"pandas_type": "unicode", "numpy_type": "object", "metadata": None}
    number = {"pandas_type": "int64", "numpy_type": "int64", "metadata": None}
    about = {
        "index_columns": ["task"],
        "column_indexes": [{"name": None, "field_name": None, **text}],
        "columns": [
            {"name": "task_index", "field_name": "task_index", **number},
            {"name": "task", "field_name": "task", **text},
        ],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.0.0",
    }
    table = pa.table({"task_index": pa.array([0], pa.int64()), "task": [task]})
    parquet.write_table(table.replace_schema_metadata({"pandas": json.dumps(about)}), path)
