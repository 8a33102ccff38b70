"""A cache of pictures on disk, without a renderer."""

import numpy as np
import pytest

from jaxcam.data.caches import Cache, is_black
from jaxcam.errors import DatasetError

SHAPE = (5, 2, 3, 3)
PICTURES = np.random.default_rng(0).integers(0, 256, SHAPE, np.uint8)
NONE, ALL = np.zeros(5, bool), np.ones(5, bool)


def filled(path, rows):
    """A cache of which some pictures are drawn."""
    cache = Cache(path, SHAPE)
    wanted = np.isin(np.arange(5), rows)
    cache.write(cache.begin(NONE, wanted), PICTURES[wanted])
    cache.finish()
    return cache


def test_what_is_drawn_is_kept_and_what_is_missing_is_asked_for(tmp_path):
    cache = filled(tmp_path / "a.npy", [1, 3])
    assert not cache.complete
    assert sorted(p.suffix for p in tmp_path.iterdir()) == [".drawn", ".part", ".sums"]
    again = Cache(tmp_path / "a.npy", SHAPE)
    assert again.drawn.tolist() == [False, True, False, True, False]
    np.testing.assert_array_equal(again.rgb[[1, 3]], PICTURES[[1, 3]])
    assert again.begin(NONE, ALL).tolist() == [0, 2, 4]
    again.write(np.array([0, 2, 4]), PICTURES[[0, 2, 4]])
    again.finish()
    assert again.complete
    assert sorted(p.suffix for p in tmp_path.iterdir()) == [".npy", ".sums"]
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), PICTURES)


@pytest.mark.parametrize("rows", [[2], [0, 1, 2, 3, 4]])
def test_a_bit_that_flips_is_noticed_where_it_is_looked_at(tmp_path, rows):
    path = filled(tmp_path / "a.npy", rows).file
    content = bytearray(path.read_bytes())
    content[-3 * 18 + 7] ^= 1  # of the third of five pictures of 18 bytes
    path.write_bytes(content)
    cache = Cache(tmp_path / "a.npy", SHAPE)
    assert np.flatnonzero(cache.damaged()).tolist() == [2]
    assert not cache.damaged(np.arange(5) != 2).any()
    assert cache.begin(cache.damaged(), ALL).tolist() == sorted({2} | set(range(5)) - set(rows))


def test_pictures_of_another_size_are_refused(tmp_path):
    filled(tmp_path / "a.npy", range(5))
    with pytest.raises(DatasetError, match=r"should be uint8 \[5, 2, 4, 3\], but are uint8 \[5, 2"):
        Cache(tmp_path / "a.npy", (5, 2, 4, 3))


def test_a_picture_without_light_is_a_fault_and_one_of_one_colour_is_none():
    """A camera beside the robot's arm sees nothing but its white plastic."""
    assert is_black(np.zeros((4, 4, 3), np.uint8))
    assert not is_black(np.full((4, 4, 3), (141, 142, 143), np.uint8))
    assert not is_black(PICTURES[0])
