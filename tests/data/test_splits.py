"""No episode and no camera is of training and of the evaluation too."""

import itertools

from jaxcam.data.splits import SPLITS, TRAIN_CAMERAS, VALIDATION_CAMERAS, episode_seeds

MOST_PAIRS = 1_000_000
"""Of an evaluation (`jaxcam.config.commands.EvaluateConfig`)."""


def test_no_seed_is_of_two_sets():
    sets = [range(s.episodes, s.episodes + MOST_PAIRS) for s in SPLITS.values()]
    sets += [episode_seeds(seed) for seed in range(50)]
    in_order = sorted(sets, key=lambda some: some.start)
    for one, other in itertools.pairwise(in_order):
        assert one.stop <= other.start
    cameras = [TRAIN_CAMERAS, VALIDATION_CAMERAS, *(s.cameras for s in SPLITS.values())]
    assert len(set(cameras)) == len(cameras)


def test_the_seeds_are_the_authors():
    assert episode_seeds(0).start == 42
    assert (TRAIN_CAMERAS, VALIDATION_CAMERAS, SPLITS["test"].cameras) == (1, 3, 23)
