"""Held-out pairs of an initial state and camera poses: the same for everyone who asks.

Pairs are numbered. A pair follows from its number, the task, the scene, the number of views and
nothing else, so it is the same for every policy, seed and checkpoint (paper, section IV-C). What
was evaluated on is stored beside the rows, with a hash of each pair, and compared when an
evaluation goes on.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxcam.config.fields import as_record, from_json
from jaxcam.config.train import TrainConfig
from jaxcam.data.demos import read_demos
from jaxcam.data.splits import SEEN_EPISODES, SPLITS, TRAIN_CAMERAS
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.files.paths import absolute, read_text
from jaxcam.files.whole import write_atomically
from jaxcam.rays import sample_poses, stair_cameras
from jaxcam.results.rows import SEEN
from jaxcam.sim import make_task
from jaxcam.sim.task import Task, starts
from jaxcam.sim.types import Start
from jaxcam.sim.world import World


class Pairs(NamedTuple):
    """Some pairs, in the order they were asked for."""

    seeds: list[int]
    """Seeds of the episodes."""
    cameras: np.ndarray
    """Camera poses (world from camera, OpenCV axes) [B, V, 4, 4]."""
    start: Start
    """Initial states."""

    def digests(self) -> list[str]:
        """A hash of each pair's arrays, rounded to 1e-6 so that it is the same everywhere."""
        arrays = [np.round(np.asarray(x, np.float64), 6) + 0.0 for x in (self.cameras, *self.start)]
        return [
            hashlib.sha256(b"".join(np.ascontiguousarray(x[i]).tobytes() for x in arrays))
            .hexdigest()[:16]
            for i in range(len(self.seeds))
        ]  # fmt: skip


def make_pairs(
    task: Task,
    scene: World,
    views: int,
    split: str,
    numbers: Sequence[int],
    trained_on: np.ndarray | None = None,
) -> Pairs:
    """The pairs of these numbers; pair p has the camera poses V p to V p + V - 1.

    Args:
        task: What starts.
        scene: Where.
        views: Cameras of a pair.
        split: `test` or `validation`; or `train`, whose starts are new and whose cameras are not.
        numbers: Of the pairs.
        trained_on: The cameras of `train` [C, 4, 4], from `cameras_seen`; after the
            last comes the first.
    """
    if split == SEEN:
        assert trained_on is not None, "pairs of train have cameras that training saw"
        rows = views * np.array(numbers)[:, None] + np.arange(views)
        seeds = [SEEN_EPISODES + number for number in numbers]
        return Pairs(seeds, trained_on[rows % len(trained_on)], starts(task, scene, seeds))
    poses = sample_poses(task.cameras, views * (max(numbers) + 1), SPLITS[split].cameras)
    seeds = [SPLITS[split].episodes + number for number in numbers]
    cameras = poses.reshape(-1, views, 4, 4)[list(numbers)]
    return Pairs(seeds, cameras, starts(task, scene, seeds))


def cameras_seen(config: TrainConfig, fingerprint: str | None = None) -> np.ndarray:
    """The cameras that a run's demonstrations are seen from, validation left out.

    Args:
        config: Resolved settings of the run.
        fingerprint: Of the demonstrations that it was trained on, if that is known.

    Returns:
        World-from-camera matrices [C, 4, 4], OpenCV axes.

    Raises:
        DatasetError: They are in a file, and it is gone, damaged or another one.
    """
    if not config.dataset:
        ranges = make_task(config.task).cameras
        count = stair_cameras(config.demos, config.n, config.m)
        return np.asarray(sample_poses(ranges, count, TRAIN_CAMERAS))
    demos = read_demos(absolute(config.dataset), task=config.task, scene=config.scene)
    if fingerprint not in (None, demos.fingerprint):
        raise DatasetError(
            f"{config.dataset} is not what the run was trained on: its fingerprint is "
            f"{demos.fingerprint}, expected {fingerprint}. Its cameras are others; put the file "
            "back."
        )
    rows = np.unique(np.concatenate([demo.cameras for demo in demos.train]))
    return np.asarray(demos.header.world_from_camera)[rows]


@dataclass(frozen=True)
class StoredPairs:
    """What a file of pairs holds."""

    sha256: str
    """Of the digests of all pairs."""
    pairs: list[dict[str, Any]]


@dataclass(frozen=True)
class StoredPair:
    """A pair as it is written down."""

    episode_seed: int
    cameras: list[Any]
    sha: str


def read_digests(file: Path) -> list[str]:
    """The digests of the pairs that were written down; none if there is no such file.

    Args:
        file: JSON file beside the rows.

    Raises:
        DatasetError: The file is damaged.
    """
    if not file.is_file():
        return []
    try:
        stored = from_json(StoredPairs, read_text(file), "file of pairs")
        digests = [as_record(StoredPair, pair, "file of pairs").sha for pair in stored.pairs]
    except (OSError, UnicodeDecodeError, ConfigError) as error:
        raise DatasetError(f"{file} cannot be read: {error}") from error
    if _whole(digests) != stored.sha256:
        raise DatasetError(f"{file} has changed since it was written.")
    return digests


def _whole(digests: Sequence[str]) -> str:
    return hashlib.sha256("".join(digests).encode()).hexdigest()


def store_pairs(file: Path, pairs: Pairs) -> None:
    """Write down the pairs 0, 1, ... of an evaluation, or check that they are those written down.

    Args:
        file: JSON file beside the rows; made if missing, longer if there are more pairs now.
        pairs: From number 0 on.

    Raises:
        DatasetError: A pair is not what it was when rows were written.
    """
    digests = pairs.digests()
    stored = read_digests(file)
    for number, (old, new) in enumerate(zip(stored, digests, strict=False)):
        if old != new:
            raise DatasetError(
                f"{file}: pair {number} was {old} and is {new} now, so this version starts "
                "it from another state or sees it from other cameras. Rows of both would not be "
                f"comparable: move {file.parent} away to evaluate this run anew."
            )
    if len(digests) <= len(stored):
        return
    each = zip(pairs.seeds, pairs.cameras.tolist(), digests, strict=True)
    records = [{"episode_seed": s, "cameras": c, "sha": d} for s, c, d in each]
    write_atomically(file, json.dumps({"sha256": _whole(digests), "pairs": records}) + "\n")
