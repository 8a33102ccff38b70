"""Episodes in any order, and what is held of them."""

import tracemalloc

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="jaxcam[lerobot] is not installed")

from lerobot_datasets import (
    HEIGHT,
    LENGTHS,
    TOP,
    WIDTH,
    shown,
    write_folder,
)

from jaxcam.interop.lerobot.reading import read_lerobot


@pytest.mark.parametrize("dtype", ["video", "image"])
def test_episodes_in_any_order_and_beside_each_other(originals, dtype):
    recording = read_lerobot(originals("v3.0", dtype)[0])
    wanted = [shown(episode) for episode in recording.episodes]
    for e in (2, 1, 0, 0, 2, 1):
        np.testing.assert_array_equal(shown(recording.episodes[e]), wanted[e])
    pairs = zip(*(recording.episodes[e].sights["top"].decode() for e in (1, 0)), strict=False)
    for t, (second, first) in enumerate(pairs):
        np.testing.assert_array_equal(second, wanted[1][t])
        np.testing.assert_array_equal(first, wanted[0][t])
    unfinished = recording.episodes[0].sights["top"].decode()
    next(unfinished)
    unfinished.close()
    np.testing.assert_array_equal(shown(recording.episodes[1]), wanted[1])


def test_memory_does_not_grow_with_the_video(tmp_path):
    root = tmp_path / "x"
    write_folder(root, "v2.1", keys=(TOP,))
    sight = read_lerobot(root).episodes[2].sights["top"]
    tracemalloc.start()
    for _ in sight.decode():
        pass
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 6 * HEIGHT * WIDTH * 3 < LENGTHS[2] * HEIGHT * WIDTH * 3
