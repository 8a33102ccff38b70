"""Success rates with honest intervals: Wilson, cluster bootstrap over pairs, paired differences.

A *pair* is one held-out (initial state, camera pose). Rollouts of several seeds or checkpoints on
the same pair are not independent, so every interval resamples pairs, never single rollouts. It
therefore speaks about new pairs of the same kind, not about seeds that were never trained. All
functions are deterministic.
"""

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, cast

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from jaxcam.results.rows import Row

LEVEL = 0.95
"""Of every interval."""
_Z = float(scipy.stats.norm.ppf((1 + LEVEL) / 2))
RESAMPLES = 10_000
"""Resamples of an interval or a test: ends of intervals move by about 0.1 points between seeds."""
_EXACT_FLIPS = 12  # pairs up to which all sign patterns are enumerated, not sampled
_BLOCK = 2_000_000  # drawn indices held in memory at once


@dataclass(frozen=True)
class Estimate:
    """A success rate with its 95 % interval, all as fractions.

    Attributes:
        value: Share of successful rollouts (NaN without rollouts).
        low: Lower end of the interval.
        high: Upper end of the interval.
        n: Rollouts counted.
        clusters: Distinct pairs among them.
        excluded: Rows left out because the rollout did not finish.
    """

    value: float
    low: float
    high: float
    n: int
    clusters: int
    excluded: int = 0

    def __str__(self) -> str:
        rate = f"{100 * self.value:.1f} % [{100 * self.low:.1f}, {100 * self.high:.1f}]"
        pairs = f" on {self.clusters} pairs" if self.clusters != self.n else ""
        left_out = f", {self.excluded} excluded" if self.excluded else ""
        return f"{rate if self.n else 'no finished rollouts'} (n = {self.n}{pairs}{left_out})"


@dataclass(frozen=True)
class PairedDifference:
    """Success of arm A minus success of arm B on the pairs both were evaluated on, as a fraction.

    Attributes:
        value: Mean over pairs of (A's mean over seeds - B's mean over seeds); NaN without pairs.
        low: Lower end of the 95 % interval.
        high: Upper end of the 95 % interval.
        p_value: Two-sided sign-flip permutation p-value of "no difference".
        pairs: Shared pairs.
        unpaired: Pairs only one arm has; they are left out.
        excluded: Rows left out because the rollout did not finish.
    """

    value: float
    low: float
    high: float
    p_value: float
    pairs: int
    unpaired: int = 0
    excluded: int = 0

    def __str__(self) -> str:
        if not self.pairs:
            return f"no shared pairs ({self.unpaired} unpaired, {self.excluded} excluded)"
        value, low, high = (100 * x for x in (self.value, self.low, self.high))
        notes = [f"p {p_text(self.p_value)}", f"{self.pairs} pairs"]
        notes += [f"{self.unpaired} unpaired"] if self.unpaired else []
        notes += [f"{self.excluded} excluded"] if self.excluded else []
        return f"{value:+.1f} points [{low:+.1f}, {high:+.1f}] ({', '.join(notes)})"


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
        rows: Evaluation rows. Those that did not finish are excluded and counted.

    Returns:
        The estimate, over all rollouts pooled.
    """
    groups, excluded = _by_pair(rows)
    if not groups:
        return Estimate(float("nan"), 0.0, 1.0, 0, 0, excluded)
    sums = np.array([sum(outcomes) for outcomes in groups.values()], float)
    sizes = np.array([len(outcomes) for outcomes in groups.values()], float)
    low, high = _bootstrap(sums, sizes, 0.0, 1.0)
    total = int(sizes.sum())
    return Estimate(float(sums.sum() / total), low, high, total, len(groups), excluded)


def paired_difference(rows_a: Iterable[Row], rows_b: Iterable[Row]) -> PairedDifference:
    """Compare two arms on the pairs they share.

    Seeds are averaged inside each pair first, so that several seeds an arm do not count as more
    pairs than there are. The interval is a bootstrap over pairs; the p-value flips the sign of each
    pair's difference (all sign patterns where there are few pairs, random ones otherwise).

    Args:
        rows_a: Evaluation rows of arm A.
        rows_b: Evaluation rows of arm B.

    Returns:
        The mean difference A - B with interval, p-value and what was left out.
    """
    (groups_a, excluded_a), (groups_b, excluded_b) = _by_pair(rows_a), _by_pair(rows_b)
    shared = [pair for pair in groups_a if pair in groups_b]
    unpaired = len(groups_a.keys() ^ groups_b.keys())
    excluded = excluded_a + excluded_b
    if not shared:
        return PairedDifference(float("nan"), -1.0, 1.0, 1.0, 0, unpaired, excluded)
    deltas = np.array([np.mean(groups_a[pair]) - np.mean(groups_b[pair]) for pair in shared])
    # Pairs that were not drawn may differ as much as any that was; where none differs, by all.
    least, most = (deltas.min(), deltas.max()) if np.ptp(deltas) else (-1.0, 1.0)
    low, high = _bootstrap(deltas, np.ones_like(deltas), least, most)
    p_value = _sign_flip_p(deltas)
    return PairedDifference(
        float(deltas.mean()), low, high, p_value, len(shared), unpaired, excluded
    )


def latest_rows(rows: Iterable[Row]) -> list[Row]:
    """Keep the last row of each rollout, so that a re-run replaces the attempt that failed.

    Rows of different engines, batch widths or ensembling are never mixed: of an evaluation that was
    run in several ways, the one run last counts.

    Args:
        rows: Evaluation rows in the order they were written.

    Returns:
        One row for each (task, scene, run, policy, conditioning, seed, step, split, pair).
    """
    evaluation_of = attrgetter(
        "task", "scene", "run", "policy", "conditioning", "seed", "step", "split"
    )
    way_of = attrgetter("width", "engine", "ensemble")
    ways: dict[Hashable, Hashable] = {}
    latest: dict[Hashable, dict[int, Row]] = {}
    for row in rows:
        evaluation, way = evaluation_of(row), way_of(row)
        if ways.get(evaluation) != way:
            ways[evaluation], latest[evaluation] = way, {}
        latest[evaluation][row.pair] = row
    return [row for pairs in latest.values() for row in pairs.values()]


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


def _by_pair(rows: Iterable[Row]) -> tuple[dict[Hashable, list[float]], int]:
    """Outcomes of finished rollouts by pair, and how many rows were not finished."""
    groups: dict[Hashable, list[float]] = {}
    excluded = 0
    for row in rows:
        if not row.finished:
            excluded += 1
            continue
        # Pair 3 of one task is not pair 3 of another.
        key = (row.task, row.scene, row.split, row.pair)
        groups.setdefault(key, []).append(float(row.success or 0))
    return groups, excluded


def _bootstrap(
    sums: np.ndarray, sizes: np.ndarray, least: float, most: float
) -> tuple[float, float]:
    """Percentile interval of sum(sums) / sum(sizes), resampling clusters.

    It allows for clusters of the values `least` and `most` that exist and have not been drawn.
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
    worst, best = value - missed * (value - least), value + missed * (most - value)
    return min(low, worst), max(high, best)


def _pooled(sums: np.ndarray, sizes: np.ndarray, axis: int) -> np.ndarray:
    return sums.sum(axis) / sizes.sum(axis)


def _sign_flip_p(deltas: np.ndarray) -> float:
    """Two-sided p-value of a zero mean under random signs of the differences."""
    moving = deltas[deltas != 0]  # a zero difference is the same under both signs
    if len(moving) < 2:
        return 1.0  # one difference is as large under both signs
    rng = np.random.default_rng(0)
    if len(moving) <= _EXACT_FLIPS:
        patterns = scipy.stats.permutation_test(
            (moving,),
            _total,
            permutation_type="samples",
            vectorized=True,
            n_resamples=2**_EXACT_FLIPS,
        )
        return float(patterns.pvalue)

    def flipped(size: tuple[int, ...]) -> np.ndarray:
        return moving * (1 - 2 * rng.integers(0, 2, size, dtype=np.int8))

    drawn = scipy.stats.monte_carlo_test(
        moving, flipped, _total, vectorized=True, n_resamples=RESAMPLES, batch=_batch(len(moving))
    )
    return float(drawn.pvalue)


def _total(deltas: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    sums = cast(NDArray[np.float64], deltas.sum(axis))
    return np.round(sums, 9)  # ties must count as ties in floating point


def _batch(count: int) -> int:
    """Resamples of so many clusters that are held in memory at once."""
    return min(max(_BLOCK // count, 1), RESAMPLES)


def p_text(p_value: float) -> str:
    """A p-value as people write it, with its sign of comparison."""
    return "< 0.001" if p_value < 0.001 else f"= {p_value:.3f}"
