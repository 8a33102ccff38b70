"""Which episodes an environment begins: held-out pairs by number, or fresh ones for training."""

import operator
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Self, get_args

import numpy as np

from jaxcam.config.names import Split
from jaxcam.data.pairs import make_pairs
from jaxcam.data.splits import FRESH_CAMERAS, SPLITS, episode_seeds
from jaxcam.errors import ConfigError, closest
from jaxcam.rays import sample_poses
from jaxcam.sim.task import Task, starts
from jaxcam.sim.types import Start
from jaxcam.sim.world import World

MOST_PAIRS = 1_000_000
"""Held-out pairs: with more, the next set's episodes would begin."""
FRESH = -1
"""Number of the pair of an episode that is none."""
_TRAINING = episode_seeds(0)
"""Seeds of fresh episodes: those that the demonstrations of seed 0 may have."""


class Begun(NamedTuple):
    """Some episodes before their first step."""

    start: Start
    """[n, ...]."""
    cameras: np.ndarray
    """Poses of their cameras, world from camera, OpenCV axes [n, V, 4, 4]."""
    pair: np.ndarray
    """Numbers of their pairs [n]; `FRESH` for what is none."""
    split: Literal["train"] | Split
    """Whose they are."""
    seed: np.ndarray
    """Seeds of the episodes [n]."""


def fresh(task: Task, world: World, views: int, rngs: Sequence[np.random.Generator]) -> Begun:
    """Episodes for training, which never are those of a held-out pair.

    Args:
        task: What begins.
        world: Where.
        views: Cameras of an episode.
        rngs: One for each episode.
    """
    seeds = [_TRAINING[int(rng.integers(len(_TRAINING)))] for rng in rngs]
    drawn = [FRESH_CAMERAS[int(rng.integers(len(FRESH_CAMERAS)))] for rng in rngs]
    cameras = np.stack([sample_poses(task.cameras, views, seed) for seed in drawn])
    none = np.full(len(seeds), FRESH)
    return Begun(starts(task, world, seeds), cameras, none, "train", np.array(seeds))


@dataclass(frozen=True)
class ResetOptions:
    """What `reset(options=…)` was asked for."""

    again: np.ndarray
    """[B] bool, which environments begin anew."""
    pairs: list[int] | None = None
    """Numbers of the pairs of those; fresh episodes when None."""
    split: Split = "test"
    """Whose pairs."""

    @classmethod
    def of(cls, given: dict[str, Any] | None, count: int) -> Self:
        """The options as they were given.

        Args:
            given: `pair` (a number, with several environments that of the first, the next one's is
                one more; or a list of all), `split`, and `reset_mask`, bool [B].
            count: Environments.

        Raises:
            ConfigError: There is no such option, or no such value of it.
        """
        given, known = {} if given is None else given, ("pair", "split", "reset_mask")
        if not isinstance(given, dict):
            raise ConfigError(f"reset: options must be a dict, got {given!r:.80}.")
        for name in given:
            if name not in known:
                raise ConfigError(f"reset: unknown option {name!r:.80}{closest(str(name), known)}.")
        again = _mask(given.get("reset_mask"), count)
        name = given.get("split", "test")
        splits = get_args(Split) if isinstance(name, str) else ()
        split = next((known for known in splits if name == known), None)
        if split is None:
            raise ConfigError(f"reset: unknown split {name!r:.80}{closest(str(name), SPLITS)}.")
        if given.get("pair") is None:
            if "split" in given:
                raise ConfigError(
                    "reset: a split has numbered pairs. Say which, such as options="
                    f'{{"pair": 0, "split": {split!r}}}, or leave out split to train.'
                )
            return cls(again)
        return cls(again, _numbers(given["pair"], int(again.sum())), split)


def _mask(mask: Any, count: int) -> np.ndarray:
    if mask is None:
        return np.ones(count, bool)
    mask = np.asarray(mask)
    if mask.dtype != bool or mask.shape != (count,) or not mask.any():
        raise ConfigError(
            f"reset: reset_mask must be bool [{count}], True somewhere; got {mask.dtype} "
            f"{list(mask.shape)}{' of False alone' * (mask.dtype == bool and not mask.any())}."
        )
    return mask


def _numbers(pair: Any, count: int) -> list[int]:
    """The numbers of pairs that `count` environments begin."""
    several = isinstance(pair, list | tuple | np.ndarray) and np.ndim(pair) == 1
    numbers = [whole_number("pair", one) for one in (pair if several else [pair])]
    if not several:
        numbers = [numbers[0] + i for i in range(count)]
    if len(numbers) != count:
        raise ConfigError(
            f"reset: pair has {len(numbers)} numbers, and {count} environments begin. Give one "
            "each, or one number for the first."
        )
    for number in numbers:
        if not 0 <= number < MOST_PAIRS:
            raise ConfigError(f"reset: pair must be 0 to {MOST_PAIRS - 1}, got {number}.")
    return numbers


def whole_number(name: str, value: Any) -> int:
    """A whole number that `reset` was given.

    Args:
        name: What it is.
        value: What was given.

    Raises:
        ConfigError: It is no whole number.
    """
    try:
        if not isinstance(value, bool | np.bool_):
            return operator.index(value)
    except TypeError:
        pass
    raise ConfigError(f"reset: {name} must be a whole number or a list of them, got {value!r:.80}.")


def of_pairs(task: Task, world: World, views: int, split: Split, numbers: list[int]) -> Begun:
    """The episodes of held-out pairs.

    Args:
        task: What begins.
        world: Where.
        views: Cameras of a pair.
        split: Whose pairs.
        numbers: Theirs.
    """
    chosen = make_pairs(task, world, views, split, numbers)
    seeds = np.array(chosen.seeds)
    return Begun(chosen.start, chosen.cameras, np.array(numbers), split, seeds)
