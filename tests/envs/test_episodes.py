"""Which episodes begin: held-out pairs are evaluation's, and fresh ones are never any of those."""

import numpy as np
import pytest

from jaxcam.data.pairs import make_pairs
from jaxcam.data.splits import FRESH_CAMERAS, SPLITS, TRAIN_CAMERAS, VALIDATION_CAMERAS
from jaxcam.envs.episodes import MOST_PAIRS, ResetOptions, fresh, of_pairs
from jaxcam.errors import ConfigError


def rngs(seed, count):
    return [np.random.default_rng([seed, i]) for i in range(count)]


def test_pairs_are_those_of_an_evaluation(lift, scene):
    ours = of_pairs(lift, scene, 2, "test", [3, 1])
    theirs = make_pairs(lift, scene, 2, "test", [3, 1])
    assert ours.seed.tolist() == theirs.seeds
    np.testing.assert_array_equal(ours.cameras, theirs.cameras)
    np.testing.assert_array_equal(ours.start.qpos, theirs.start.qpos)


def test_fresh_episodes_are_their_own_and_no_pairs(lift, scene):
    first, again, other = (fresh(lift, scene, 2, rngs(seed, 40)) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.cameras, again.cameras)
    np.testing.assert_array_equal(first.start.qpos, again.start.qpos)
    seeds = set(first.seed) | set(other.seed)
    assert len(seeds) == 80
    assert max(seeds) < min(split.episodes for split in SPLITS.values())
    assert first.cameras.shape == (40, 2, 4, 4)
    assert len(np.unique(first.cameras[:, 0, 0, 3])) == 40
    sets = {TRAIN_CAMERAS, VALIDATION_CAMERAS, *(split.cameras for split in SPLITS.values())}
    assert max(sets) < FRESH_CAMERAS.start
    assert FRESH_CAMERAS.stop <= 2**32  # what NumPy's legacy generator takes


def test_pairs_end_where_the_next_sets_begin():
    firsts = sorted(split.episodes for split in SPLITS.values())
    assert firsts[0] + MOST_PAIRS <= firsts[1]


@pytest.mark.parametrize(
    ("given", "pairs"),
    [
        (None, None),
        ({}, None),
        ({"pair": 4}, [4, 5]),
        ({"pair": np.int64(4)}, [4, 5]),
        ({"pair": np.array([4, 2])}, [4, 2]),
        ({"pair": 9, "reset_mask": np.array([False, True])}, [9]),
    ],
)
def test_what_is_asked_for(given, pairs):
    assert ResetOptions.of(given, 2).pairs == pairs


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"pairs": 1}, "unknown option 'pairs', did you mean 'pair'"),
        ({"pair": -1}, "pair must be 0 to 999999, got -1"),
        ({"pair": 999_999}, "pair must be 0 to 999999, got 1000000"),
        ({"pair": 1.0}, "whole number"),
        ({"pair": True}, "whole number"),
        ({"pair": "1"}, "whole number"),
        ({"pair": [1, 2, 3]}, "3 numbers, and 2 environments"),
        ({"pair": [[1, 2]]}, "whole number"),
        ({"pair": 0, "split": "train"}, "unknown split 'train'"),
        ({"pair": 0, "split": ["test"]}, "unknown split"),
        ({"pair": 0, "split": np.array(["test", "x"])}, "unknown split"),
        ({"split": "test"}, "a split has numbered pairs"),
        ({"reset_mask": [1, 0]}, r"reset_mask must be bool \[2\]"),
        ({"reset_mask": np.ones(3, bool)}, r"reset_mask must be bool \[2\]"),
        ({"reset_mask": np.zeros(2, bool)}, "False alone"),
        ([1], "must be a dict"),
    ],
)
def test_what_cannot_be_asked_for(given, message):
    with pytest.raises(ConfigError, match=message):
        ResetOptions.of(given, 2)
