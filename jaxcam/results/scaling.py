"""Success against the number of cameras and of demonstrations: a fitted law, and its error.

The odds of failure are a floor, and a part that falls with a power of either number:

    (1 - p) / p = floor + a * cameras ** -alpha + b * demonstrations ** -beta

This is the form in which losses of language models are fitted to their parameters and data
(Hoffmann et al., 2022), on odds, since successes are shares. It is fitted by the likelihood of the
successes. How good it is, is told by cells that were left out: each in turn is predicted from the
others.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.optimize

from jaxcam.results.rows import Row
from jaxcam.results.stats import LEVEL, shared_outcomes

Counts = tuple[float, float]
"""Numbers of cameras and of demonstrations."""
LEAST_CELLS = 6
"""One more than the law has numbers."""
LEAST_PAIRS = 20
"""Below which shares say too little."""
MATTERS = 5.99
"""Twice the logarithm of likelihoods from which on a number matters: 95 % of a chi-squared one of
two degrees of freedom, its factor and its exponent."""
_RESAMPLES = 200
_STEEPEST = 4.0
"""Exponents are at most this."""
_ODDS = -12.0, 12.0
"""Logarithms of the least and the largest part of the odds of failure."""
_STARTS = np.array(
    [(-2.0, 1.0, 0.5, 1.0, 0.5), (-6.0, 2.0, 1.0, -1.0, 0.3), (0.0, -1.0, 0.3, 2.0, 1.0)]
)
"""Logarithms of floor, a and b, each of these two before its exponent."""


@dataclass(frozen=True)
class FittedNumber:
    """A number with its 95 % interval over pairs."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.2f} [{self.low:.2f}, {self.high:.2f}]"


@dataclass(frozen=True)
class ScalingLaw:
    """What was fitted.

    Attributes:
        cells: Numbers of cameras and demonstrations, [C, 2].
        rates: Success of each, [C].
        floor: Odds of failure that neither number lowers.
        alpha: Exponent of the cameras; None where they are not seen to matter, and have no part.
        beta: Exponent of the demonstrations, likewise.
        error: Of cells that were left out, mean of the absolute difference (share of rollouts).
        by_chance: What the same is of a law that holds, by the number of pairs alone.
        pairs: That all cells share.
        numbers: Logarithm of the floor, then of a and of b, each before its exponent, [5].
    """

    cells: np.ndarray
    rates: np.ndarray
    floor: FittedNumber
    alpha: FittedNumber | None
    beta: FittedNumber | None
    error: float
    by_chance: float
    pairs: int
    numbers: np.ndarray

    def at(self, cameras: np.ndarray | float, demos: np.ndarray | float) -> np.ndarray:
        """Success by the law, of the numbers' common shape.

        Args:
            cameras: Numbers of cameras.
            demos: Numbers of demonstrations.
        """
        cells = np.stack(np.broadcast_arrays(cameras, demos), -1).astype(float)
        return success_by_law(self.numbers, cells)


def scaling_law(cells: Mapping[Counts, Sequence[Row]]) -> ScalingLaw | None:
    """The law of some cells, or None.

    It takes `LEAST_CELLS` cells, some of which differ in their cameras alone and some in their
    demonstrations alone, `LEAST_PAIRS` pairs that were tried in all of them, and a success and a
    failure among these.

    Args:
        cells: Rows by the numbers of cameras and of demonstrations.
    """
    alone = [len({at[i] for at in cells}) < len(cells) for i in (0, 1)]
    if len(cells) < LEAST_CELLS or not all(alone):
        return None
    outcomes = shared_outcomes(cells.values())
    if outcomes.shape[-1] < LEAST_PAIRS or outcomes.max() == 0 or outcomes.min() == 1:
        return None
    return fit_scaling(np.array([*cells], float), outcomes)


def fit_scaling(cells: np.ndarray, outcomes: np.ndarray) -> ScalingLaw:
    """The law of mean outcomes of pairs.

    Args:
        cells: Numbers of cameras and demonstrations, [C, 2].
        outcomes: In each cell, of each pair, [C, N].
    """
    scale = np.exp(np.log(cells).mean(0))  # powers of what is near 1 can be told from their factors
    scaled, rates, pairs = cells / scale, outcomes.mean(1), outcomes.shape[1]
    without = _without(scaled, rates, pairs * len(cells))
    numbers = _fitted(scaled, rates, _STARTS, without)[0]
    weights = np.random.default_rng(0).multinomial(pairs, np.full(pairs, 1 / pairs), _RESAMPLES)
    drawn = weights / pairs @ outcomes.T
    others = np.array([_fitted(scaled, some, numbers[None], without)[0] for some in drawn])
    tail = (1 - LEVEL) / 2
    low, high = np.quantile(others, [tail, 1 - tail], axis=0)
    floor = FittedNumber(*(float(np.exp(x[0])) for x in (numbers, low, high)))
    alpha, beta = (
        None if axis in without else FittedNumber(
            *(float(x[2 + 2 * axis]) for x in (numbers, low, high)))
        for axis in (0, 1)
    )  # fmt: skip
    rest = [np.arange(len(cells)) != i for i in range(len(cells))]
    predicted = [
        float(success_by_law(_fitted(scaled[some], rates[some], _STARTS, without)[0], scaled[i]))
        for i, some in enumerate(rest)
    ]
    numbers[[1, 3]] += numbers[[2, 4]] * np.log(scale)  # of what was counted, not of its share
    law = success_by_law(numbers, cells)
    chance = np.sqrt(2 / np.pi * law * (1 - law) / pairs)  # mean of a normal number's size
    error = float(abs(predicted - rates).mean())
    return ScalingLaw(cells, rates, floor, alpha, beta, error, float(chance.mean()), pairs, numbers)


def success_by_law(numbers: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Success by the law.

    Args:
        numbers: As `ScalingLaw` has them.
        cells: Numbers of cameras and demonstrations, [..., 2].
    """
    return 1 / (1 + np.exp(_parts(numbers, cells)).sum(0))


def _parts(numbers: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Logarithms of what the odds of failure are the sum of, [3, ...]."""
    falling = numbers[[1, 3]] - numbers[[2, 4]] * np.log(cells)
    return np.stack([np.full(cells.shape[:-1], numbers[0]), falling[..., 0], falling[..., 1]])


def _without(cells: np.ndarray, rates: np.ndarray, rollouts: int) -> tuple[int, ...]:
    """Which of cameras (0) and demonstrations (1) are not seen to matter."""
    whole = _fitted(cells, rates, _STARTS)[1]
    lost = [_fitted(cells, rates, _STARTS, (axis,))[1] - whole for axis in (0, 1)]
    alike = tuple(axis for axis in (0, 1) if 2 * rollouts * lost[axis] < MATTERS)
    if len(alike) == 2:  # what either of them says may be what neither says alone
        nothing = _fitted(cells, rates, _STARTS, alike)[1] - whole
        return alike if 2 * rollouts * nothing < MATTERS else ()
    return alike


def _fitted(
    cells: np.ndarray, rates: np.ndarray, starts: np.ndarray, without: tuple[int, ...] = ()
) -> tuple[np.ndarray, float]:
    """The numbers of the law that make the successes likeliest, and how unlikely these are.

    Parts of the law that it is fitted `without` are next to nothing.
    """
    limits = [_ODDS, _ODDS, (0.0, _STEEPEST), _ODDS, (0.0, _STEEPEST)]
    for axis in without:
        limits[1 + 2 * axis : 3 + 2 * axis] = [(_ODDS[0], _ODDS[0]), (0.0, 0.0)]
    slopes = -np.log(cells).T

    def unlikely(numbers: np.ndarray) -> tuple[float, np.ndarray]:
        parts = np.exp(_parts(numbers, cells))
        odds = parts.sum(0)
        value = np.log1p(odds) - (1 - rates) * np.log(odds)
        pulls = parts * (1 / (1 + odds) - (1 - rates) / odds)
        gradient = np.concatenate([pulls, pulls[1:] * slopes])[[0, 1, 3, 2, 4]]
        return float(value.mean()), gradient.mean(1)

    fits = [
        scipy.optimize.minimize(unlikely, start, method="L-BFGS-B", jac=True, bounds=limits)
        for start in starts
    ]
    best = min(fits, key=lambda one: one.fun)
    return best.x, float(best.fun)
