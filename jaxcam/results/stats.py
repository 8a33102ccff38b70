"""Success rates with honest intervals: Wilson, and a cluster bootstrap over pairs.

A *pair* is one held-out (initial state, camera pose). Rollouts of several seeds or checkpoints on
the same pair are not independent, so an interval is over pairs, never over single rollouts. It
speaks about new pairs of the same kind; what new seeds would give is said beside it: the rate of
each seed, and from three seeds on an interval over both. All functions are deterministic.
"""

import math
from collections import Counter
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np
import scipy.stats

from jaxcam.results.rows import Row

LEVEL = 0.95
"""Of every interval."""
_Z = float(scipy.stats.norm.ppf((1 + LEVEL) / 2))
RESAMPLES = 10_000
"""Resamples of an interval: its ends move by about 0.1 points between seeds."""
_FEW_SEEDS = 3
"""Seeds from which on an interval speaks about new ones too."""
_BLOCK = 2_000_000  # drawn indices held in memory at once


PairOutcomes = Mapping[Hashable, Sequence[Row]]
"""The rows that have an outcome, by their pair."""


@dataclass(frozen=True)
class Estimate:
    """A success rate with its 95 % interval, all as fractions.

    Attributes:
        value: Share of successful rollouts (NaN without rollouts).
        low: Lower end of the interval over pairs.
        high: Upper end of the interval over pairs.
        n: Rollouts counted.
        clusters: Distinct pairs among them.
        excluded: Rows left out because the simulator failed, or an older version did not say what.
        broken: Rollouts counted as failures because the policy gave no actions.
        seeds: The rate of each seed, where there are several.
        over_seeds: The 95 % interval over new pairs and new seeds, where there are at least three
            seeds; None otherwise.
    """

    value: float
    low: float
    high: float
    n: int
    clusters: int
    excluded: int = 0
    broken: int = 0
    seeds: tuple[float, ...] = ()
    over_seeds: tuple[float, float] | None = None

    def __str__(self) -> str:
        rate = f"{100 * self.value:.1f} % [{100 * self.low:.1f}, {100 * self.high:.1f}]"
        pairs = f" on {self.clusters} pairs" if self.clusters != self.n else ""
        notes = [f"n = {self.n}{pairs}"]
        notes += [f"{self.broken} without actions"] if self.broken else []
        notes += [f"{self.excluded} excluded"] if self.excluded else []
        notes += self.of_seeds()
        return f"{rate if self.n else 'no finished rollouts'} ({', '.join(notes)})"

    def of_seeds(self) -> list[str]:
        """The spread over seeds in words, and the interval over both; nothing with one seed."""
        if not self.seeds:
            return []
        words = [f"seeds {100 * min(self.seeds):.1f} to {100 * max(self.seeds):.1f}"]
        if self.over_seeds:
            low, high = (100 * end for end in self.over_seeds)
            words.append(f"over pairs and seeds [{low:.1f}, {high:.1f}]")
        return words


def causes(rows: Iterable[Row]) -> list[str]:
    """Why policies gave no actions, the most frequent cause first, with how many rollouts it ended.

    Args:
        rows: Of any rollouts.
    """
    words = Counter(row.cause for row in rows if row.status == "policy" and row.cause)
    return [
        f"No actions in {n} rollout{'s' if n > 1 else ''}: {cause}"
        for cause, n in words.most_common()
    ]


def wilson(successes: float, n: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share, for independent rollouts.

    As `scipy.stats.binomtest` has it, but a count may have a fraction: rollouts of several seeds on
    one camera are one trial with their mean outcome.

    Args:
        successes: How many succeeded, 0 to n.
        n: How many were tried.

    Returns:
        Lower and upper end; (0, 1) when nothing was tried.
    """
    if n < 0 or not 0 <= successes <= n:
        raise ValueError(f"need 0 <= successes <= n, got successes = {successes}, n = {n}")
    if n == 0:
        return 0.0, 1.0
    share, z2 = successes / n, _Z**2
    centre = (share + z2 / (2 * n)) / (1 + z2 / n)
    half = _Z / (1 + z2 / n) * np.sqrt(share * (1 - share) / n + z2 / (4 * n**2))
    return float(max(centre - half, 0.0)), float(min(centre + half, 1.0))


def success_rate(rows: Iterable[Row]) -> Estimate:
    """Success rate with a cluster-bootstrap interval over pairs.

    With one row a pair this is the ordinary bootstrap. Where (almost) all pairs agree, resampling
    alone would give an interval of (almost) no width, so the interval always allows for the share
    of pairs of another kind that this many pairs can have missed; at 0 and 100 % that is Wilson's.

    Args:
        rows: Evaluation rows. Those without an outcome (the simulator failed) are excluded and
            counted; where the policy gave no actions, that is a failure and counts as one.

    Returns:
        The estimate, over all rollouts pooled.
    """
    groups, excluded = by_pair(rows)
    if not groups:
        return Estimate(float("nan"), 0.0, 1.0, 0, 0, excluded)
    sums = np.array([sum(bool(row.success) for row in some) for some in groups.values()], float)
    sizes = np.array([len(some) for some in groups.values()], float)
    low, high = _bootstrap(sums, sizes)
    total, value = int(sizes.sum()), float(sums.sum() / sizes.sum())
    seeds = [*by_seed(groups).values()]
    # How far each pair moves the rate, which for pairs of one size is its own mean.
    moved = value + (sums - value * sizes) / sizes.mean()
    return Estimate(
        value,
        low,
        high,
        total,
        len(groups),
        excluded,
        broken=sum(row.status == "policy" for some in groups.values() for row in some),
        seeds=tuple(seeds) if len(seeds) > 1 else (),
        over_seeds=with_seeds(value, moved, [seeds], (low, high), (0.0, 1.0)),
    )


def with_seeds(
    value: float,
    of_pairs: np.ndarray,
    of_seeds: Sequence[Sequence[float]],
    alone: tuple[float, float],
    limits: tuple[float, float],
) -> tuple[float, float] | None:
    """The interval over new pairs and new seeds: both variances add up.

    What pairs and seeds have in common is then counted twice, so it is rather too wide (Owen's
    bootstrap of both sides has that variance). Degrees of freedom are Satterthwaite's.

    Args:
        value: The estimate.
        of_pairs: What each pair gives [N].
        of_seeds: What each seed gives, for each arm.
        alone: The interval over pairs alone, which it contains.
        limits: What it cannot exceed.

    Returns:
        Its ends; None where an arm has fewer than three seeds, or there is a single pair.
    """
    parts = [of_pairs, *(np.array(seeds) for seeds in of_seeds)]
    if len(of_pairs) < 2 or any(len(part) < _FEW_SEEDS for part in parts[1:]):
        return None
    variances = [float(part.var(ddof=1)) / len(part) for part in parts]
    total = sum(variances)
    if not total:
        return alone
    shares = sum(v**2 / (len(part) - 1) for v, part in zip(variances, parts, strict=True))
    half = float(scipy.stats.t.ppf((1 + LEVEL) / 2, total**2 / shares)) * total**0.5
    low, high = min(value - half, alone[0]), max(value + half, alone[1])
    return max(low, limits[0]), min(high, limits[1])


def latest_rows(rows: Iterable[Row]) -> list[Row]:
    """Keep the last row of each rollout, so that a re-run replaces the attempt that failed.

    Rows of different engines, batch widths or ensembling are never mixed: of an evaluation that was
    run in several ways, the one run last counts. Those of other conditions are other evaluations.

    Args:
        rows: Evaluation rows in the order they were written.

    Returns:
        One row for each (task, scene, run, policy, conditioning, seed, step, split, conditions,
        pair).
    """
    evaluation_of = attrgetter(
        "task", "scene", "run", "policy", "conditioning", "seed", "step", "split", "conditions"
    )
    last_way: dict[Hashable, Hashable] = {}
    latest: dict[Hashable, dict[Hashable, dict[int, Row]]] = {}
    for row in rows:
        evaluation, way = evaluation_of(row), row.way
        last_way[evaluation] = way
        latest.setdefault(evaluation, {}).setdefault(way, {})[row.pair] = row
    return [row for it, way in last_way.items() for row in latest[it][way].values()]


def by_field(rows: Sequence[Row], name: str) -> dict[Any, list[Row]]:
    """Split rows by the value of one field, in order of first appearance.

    Args:
        rows: Evaluation rows.
        name: A field such as "seed" or "step".

    Returns:
        Rows by value.
    """
    groups: dict[Any, list[Row]] = {}
    for row in rows:
        groups.setdefault(getattr(row, name), []).append(row)
    return groups


def by_pair(rows: Iterable[Row]) -> tuple[dict[Hashable, list[Row]], int]:
    """The rows that have an outcome by their pair, and how many have none.

    Args:
        rows: Evaluation rows.
    """
    groups: dict[Hashable, list[Row]] = {}
    excluded = 0
    for row in rows:
        if not row.finished:
            excluded += 1
            continue
        # Pair 3 of one task is not pair 3 of another.
        groups.setdefault((row.task, row.scene, row.split, row.pair), []).append(row)
    return groups, excluded


def shared_outcomes(several: Iterable[Iterable[Row]]) -> np.ndarray:
    """The mean outcome of each pair that all have rows of, in the order of the first, [K, N].

    Args:
        several: K times rows.
    """
    means = [
        {pair: float(np.mean([bool(r.success) for r in some])) for pair, some in groups.items()}
        for groups, _ in map(by_pair, several)
    ]
    shared = [pair for pair in means[0] if all(pair in some for some in means)]
    return np.array([[some[pair] for pair in shared] for some in means])


def by_seed(groups: PairOutcomes) -> dict[int | None, float]:
    """The success rate of each seed, in order.

    Args:
        groups: From `by_pair`.
    """
    outcomes: dict[int | None, list[bool]] = {}
    for row in (row for some in groups.values() for row in some):
        outcomes.setdefault(row.seed, []).append(bool(row.success))
    order = sorted(outcomes, key=lambda seed: (seed is None, seed or 0))
    return {seed: float(np.mean(outcomes[seed])) for seed in order}


def _bootstrap(sums: np.ndarray, sizes: np.ndarray) -> tuple[float, float]:
    """Percentile interval of sum(sums) / sum(sizes), resampling clusters.

    It allows for clusters of nothing but failures, or successes, that have not been drawn.
    """
    count, value = len(sums), float(sums.sum() / sizes.sum())
    low = high = value
    if count > 1:
        drawn = scipy.stats.bootstrap(
            (sums, sizes), _pooled, paired=True, vectorized=True, method="percentile",
            n_resamples=RESAMPLES, confidence_level=LEVEL, batch=_batch(count),
            rng=np.random.default_rng(0),
        )  # fmt: skip
        low, high = map(float, drawn.confidence_interval)
    missed = wilson(0, count)[1]  # share of clusters that may exist and never have been drawn
    return min(low, value - missed * value), max(high, value + missed * (1 - value))


def _pooled(sums: np.ndarray, sizes: np.ndarray, axis: int) -> np.ndarray:
    return sums.sum(axis) / sizes.sum(axis)


def _batch(count: int) -> int:
    """Resamples of so many clusters that are held in memory at once."""
    return min(max(_BLOCK // count, 1), RESAMPLES)


def gap_between(a: Estimate, b: Estimate) -> tuple[float, float, float]:
    """Rate of a less that of b, of rollouts on different pairs, with its interval.

    The distances from each rate to the ends of its interval are added in squares (Newcombe 1998,
    method 10, with our intervals of one rate).

    Args:
        a: A rate with its interval.
        b: Another, of other pairs.

    Returns:
        The difference and the ends of its interval.
    """
    gap = a.value - b.value
    down = math.hypot(a.value - a.low, b.high - b.value)
    up = math.hypot(a.high - a.value, b.value - b.low)
    return gap, max(gap - down, -1.0), min(gap + up, 1.0)


def p_text(p_value: float) -> str:
    """A p-value as people write it, with its sign of comparison."""
    return "< 0.001" if p_value < 0.001 else f"= {p_value:.3f}"
