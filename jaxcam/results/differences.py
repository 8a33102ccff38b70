"""Paired differences of two arms: one estimate of how sure they are, which gives interval and p.

The mean difference over pairs is held against Student's t, after two pairs are added that were
never run, one for each arm and as far apart as large differences are (for single rollouts that is
Bonett and Price's adjustment, a pair more in either discordant cell). Without them few pairs that
happen to agree would leave no doubt. The p-value is where the same interval would end at
zero, so the two never contradict each other.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.stats

from jaxcam.results.rows import Row
from jaxcam.results.stats import (
    LEVEL,
    PairOutcomes,
    by_pair,
    by_seed,
    p_text,
    with_seeds,
)

_MANY = 50
"""Pairs from which on the differences that were seen stand for those that were not. With fewer,
small differences on pairs that nearly all succeed hide large ones on the few that do not."""


@dataclass(frozen=True)
class PairedDifference:
    """Success of arm A minus success of arm B on the pairs both were evaluated on, as a fraction.

    Attributes:
        value: Mean over pairs of (A's mean over seeds - B's mean over seeds); NaN without pairs.
        low: Lower end of the 95 % interval.
        high: Upper end of the 95 % interval.
        p_value: Two-sided p-value of "no difference"; below 0.05 where the interval leaves out 0.
        pairs: Shared pairs.
        unpaired: Pairs only one arm has; they are left out.
        excluded: Rows left out because the simulator failed.
        seeds: The difference of each seed that both arms have, where there are several.
        over_seeds: The 95 % interval over new pairs and new seeds, where each arm has at least
            three; None otherwise.
    """

    value: float
    low: float
    high: float
    p_value: float
    pairs: int
    unpaired: int = 0
    excluded: int = 0
    seeds: tuple[float, ...] = ()
    over_seeds: tuple[float, float] | None = None

    def __str__(self) -> str:
        if not self.pairs:
            return f"no shared pairs ({self.unpaired} unpaired, {self.excluded} excluded)"
        value, low, high = (100 * x for x in (self.value, self.low, self.high))
        notes = [f"p {p_text(self.p_value)}", f"{self.pairs} pairs"]
        notes += [f"{self.unpaired} unpaired"] if self.unpaired else []
        notes += [f"{self.excluded} excluded"] if self.excluded else []
        notes += self.of_seeds()
        return f"{value:+.1f} points [{low:+.1f}, {high:+.1f}] ({', '.join(notes)})"

    def of_seeds(self) -> list[str]:
        """The spread over seeds in words, and the interval over both; nothing with one seed."""
        words: list[str] = []
        if self.seeds:
            words.append(f"seeds {100 * min(self.seeds):+.1f} to {100 * max(self.seeds):+.1f}")
        if self.over_seeds:
            wide = ", ".join(f"{100 * end:+.1f}" for end in self.over_seeds)
            words.append(f"over pairs and seeds [{wide}]")
        return words


def paired_difference(rows_a: Iterable[Row], rows_b: Iterable[Row]) -> PairedDifference:
    """Compare two arms on the pairs they share.

    Seeds are averaged inside each pair first, so that several seeds an arm do not count as more
    pairs than there are.

    Args:
        rows_a: Evaluation rows of arm A.
        rows_b: Evaluation rows of arm B.

    Returns:
        The mean difference A - B with interval, p-value and what was left out.
    """
    (groups_a, excluded_a), (groups_b, excluded_b) = by_pair(rows_a), by_pair(rows_b)
    shared = [pair for pair in groups_a if pair in groups_b]
    unpaired = len(groups_a.keys() ^ groups_b.keys())
    excluded = excluded_a + excluded_b
    if not shared:
        return PairedDifference(float("nan"), -1.0, 1.0, 1.0, 0, unpaired, excluded)
    deltas = np.array([_mean(groups_a, pair) - _mean(groups_b, pair) for pair in shared])
    low, high, p_value = studentised(deltas)
    seeds_a, seeds_b = (by_seed({pair: g[pair] for pair in shared}) for g in (groups_a, groups_b))
    both = [seed for seed in seeds_a if seed in seeds_b]
    return PairedDifference(
        value=float(deltas.mean()),
        low=low,
        high=high,
        p_value=p_value,
        pairs=len(shared),
        unpaired=unpaired,
        excluded=excluded,
        seeds=tuple(seeds_a[seed] - seeds_b[seed] for seed in both) if len(both) > 1 else (),
        over_seeds=with_seeds(
            float(deltas.mean()), deltas, [[*seeds_a.values()], [*seeds_b.values()]],
            (low, high), (-1.0, 1.0),
        ),
    )  # fmt: skip


def studentised(deltas: np.ndarray) -> tuple[float, float, float]:
    """The interval of a mean difference, and its p-value.

    Args:
        deltas: Difference of each pair, -1 to 1 [N].

    Returns:
        Lower end, upper end, and the two-sided p-value of a mean of zero.
    """
    count = len(deltas)
    if count < 2:
        return -1.0, 1.0, 1.0
    squares = deltas**2
    # The square of the pairs that are added: large differences, of which few pairs know little,
    # weigh most in it; where there are few pairs it is nearly the largest that there can be.
    known = float(np.sum(squares**2) / np.sum(squares)) if squares.any() else 1.0
    added = known + (1 - known) * max(0.0, 1 - count / _MANY)
    total = count + 2
    mean = float(deltas.sum()) / total
    variance = (float(squares.sum()) + 2 * added) / total - mean**2
    error = (variance / total) ** 0.5
    student: Any = scipy.stats.t(count - 1)
    half = float(student.ppf((1 + LEVEL) / 2)) * error
    # A sum of differences that cancel is zero, also in floating point.
    p_value = 2 * float(student.sf(abs(round(mean, 12)) / error))
    return max(mean - half, -1.0), min(mean + half, 1.0), p_value


def _mean(groups: PairOutcomes, pair: object) -> float:
    """Of the rollouts of a pair."""
    outcomes = [bool(row.success) for row in groups[pair]]
    return sum(outcomes) / len(outcomes)
