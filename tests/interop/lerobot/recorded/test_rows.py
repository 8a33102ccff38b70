"""Rows that are those of the episodes, and rows that are not."""

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="jaxcam[lerobot] is not installed")

import pyarrow as pa
from lerobot_datasets import (
    EPISODES,
    check_pictures,
    data_file,
    edit_table,
    refused,
)
from pyarrow import parquet

from jaxcam.interop.lerobot.reading import read_lerobot


def test_episodes_keep_their_order_wherever_their_rows_are(copied, originals):
    root, made = copied(), originals()[1]
    first, second = sorted((root / "data").rglob("*.parquet"))
    rows = pa.concat_tables([parquet.read_table(first), parquet.read_table(second)])
    parquet.write_table(pa.concat_tables([rows[6:10]]), second)
    parquet.write_table(pa.concat_tables([rows[:6], rows[10:]]), first)
    edit_table(root / EPISODES, **{"data/file_index": [0, 1, 0]})
    recording = read_lerobot(root)
    for episode, state in zip(recording.episodes, made.states, strict=True):
        np.testing.assert_array_equal(episode.state, state)
    check_pictures(recording, made)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"episode_index": [0] * 5 + [1] * 5}, "episode 0 has 5 rows, and meta says 6 steps"),
        ({"episode_index": [0] * 6 + [1] * 3 + [7]}, "rows of episode 7, which meta does not"),
        ({"episode_index": [0, 1] * 5}, "rows of one episode_index are not together"),
        ({"frame_index": [0, 1, 3, 2, 4, 5, 0, 1, 2, 3]}, "frame_index 3 in its row 2"),
        ({"episode_index": [0.0] * 6 + [float("inf")] * 4}, "whole numbers, got float64"),
        ({"episode_index": [[0, 1]] * 10}, "'episode_index' has 2 numbers a row"),
        ({"index": list(range(1, 11))}, "the index of episode 0 counts from 1"),
        ({"timestamp": [0.0] * 10}, "timestamps of episode 0 do not rise"),
        ({"timestamp": [float("inf")] * 10}, "timestamps of episode 0 do not rise"),
        ({"task_index": [5] * 10}, "episode 0 has the task_index 5"),
        ({"timestamp": None}, "has no column 'timestamp'"),
        ({"action": [[0.0, 1.0]] * 9 + [[0.0]]}, "'action' has rows of 1 to 2 numbers"),
        ({"action": [[0.0, 1.0]] * 9 + [None]}, "'action' has 1 empty places"),
        ({"action": ["left"] * 10}, "'action' are no numbers but string"),
        ({"action": [[0.0, float("nan")]] * 10}, "episode 0: 'y' of action is nan in step 0"),
        ({"action": [[0.0, 1e300]] * 10}, "episode 0: 'y' of action is inf in step 0"),
        ({"observation.state": [[float("nan")] * 3] * 10}, "'a' of observation.state is nan"),
    ],
)
def test_rows_that_cannot_be(copied, columns, words):
    root = copied()
    edit_table(data_file(root), **columns)
    refused(root, words)
