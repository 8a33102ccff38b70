"""Which seeds belong to training, to validation and to the evaluation's pairs: none is in two.

Episodes and cameras have seeds of their own. Those of cameras are the authors': with robosuite's
ranges they give the released sets.
"""

from typing import NamedTuple


class PairSeeds(NamedTuple):
    """What a set of held-out pairs begins with."""

    episodes: int
    """Seed of the first pair's episode; the next pair's is one more."""
    cameras: int
    """Seed of all its cameras."""


SPLITS: dict[str, PairSeeds] = {
    "test": PairSeeds(episodes=1_000_000, cameras=23),
    "validation": PairSeeds(episodes=2_000_000, cameras=5),
}
"""The sets of held-out pairs (`jaxcam.data.pairs`): results are on `test`, settings are chosen on
`validation`."""
SEEN_EPISODES = 3_000_000
"""Episode seed of the first pair of a new start and cameras that training saw."""
FIRST_SEED = 42
"""First episode seed of the demonstrations (authors' generators)."""
SEED_STRIDE, SEEDS = 10_000_000, 900_000
"""Distance between the episode seeds of two datasets, and how many each has: none ever reaches
those of the pairs."""
TRAIN_CAMERAS = 1
"""Seed of the cameras of training demonstrations."""
VALIDATION_CAMERAS = 3
"""Seed of the cameras of validation demonstrations."""

FRESH_CAMERAS = range(1_000, 2**31)
"""Seeds of cameras that are drawn anew for an episode: those of no set."""


def episode_seeds(seed: int) -> range:
    """The episode seeds that the dataset of a seed may use."""
    first = FIRST_SEED + SEED_STRIDE * seed
    return range(first, first + SEEDS)


NO_VALIDATION = (
    "No validation demonstrations: training on it gives no validation loss, by which overfitting "
    "would be seen."
)
"""What is said of a dataset without any, when it is imported and when it is trained on."""
