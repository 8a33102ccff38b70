"""Which error halves what a policy gains by being told its camera, and how sure that is.

Success falls with the error, so the curve is made monotone first (isotonic regression: neighbours
that rise are averaged); between the levels that were tried it is a straight line. The gain is what
is above an image-only policy, which no such error reaches. Pairs are resampled, each with all that
happened on it, so the interval is over new pairs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.optimize

from jaxcam.results.rows import Row
from jaxcam.results.stats import LEVEL, shared_outcomes

_RESAMPLES = 2000


@dataclass(frozen=True)
class HalvingError:
    """The error at which half of a gain is left.

    Attributes:
        value: In units of the levels; inf where more than half is left at the largest, NaN where
            there is no gain without an error.
        low: Lower end of the 95 % interval.
        high: Upper end; inf where it is beyond the largest level.
        largest: Of the levels.
        pairs: Shared by all levels and the image-only policy.
    """

    value: float
    low: float
    high: float
    largest: float
    pairs: int

    def __str__(self) -> str:
        if np.isnan(self.value):
            return f"no gain to halve ({self.pairs} pairs)"
        value, high = (
            f"> {self.largest:g}" if np.isinf(x) else f"{x:.2g}" for x in (self.value, self.high)
        )
        return f"{value} [{self.low:.2g}, {high}] ({self.pairs} pairs)"


def halving_error(
    curve: Sequence[tuple[float, Sequence[Row]]], image_only: Sequence[Row]
) -> HalvingError:
    """The error that halves the gain over an image-only policy.

    Args:
        curve: Each level with the rows at it; one is 0.
        image_only: Rows of the policy that is told nothing.
    """
    ordered = sorted(curve, key=lambda one: one[0])
    levels = np.array([level for level, _ in ordered])
    outcomes = shared_outcomes([*(rows for _, rows in ordered), image_only])
    return halving(levels, outcomes[:-1], outcomes[-1])


def halving(levels: np.ndarray, outcomes: np.ndarray, image_only: np.ndarray) -> HalvingError:
    """The error that halves the gain, from the mean outcomes of pairs.

    Args:
        levels: Ascending, the first one 0 [L].
        outcomes: At each level, of each pair [L, N].
        image_only: Of the policy that is told nothing [N].
    """
    count, largest = len(image_only), float(levels[-1])
    if not count:
        return HalvingError(np.nan, 0.0, np.inf, largest, 0)
    value = _crossing(levels, outcomes.mean(1), float(image_only.mean()))
    rng = np.random.default_rng(0)
    drawn = rng.multinomial(count, np.full(count, 1 / count), _RESAMPLES) / count
    curves, bases = drawn @ outcomes.T, drawn @ image_only
    crossings = np.array([_crossing(levels, c, b) for c, b in zip(curves, bases, strict=True)])
    # Where there is nothing to halve, any error might be it.
    tail = (1 - LEVEL) / 2
    low = np.quantile(np.nan_to_num(crossings, nan=0.0, posinf=np.inf), tail, method="lower")
    high = np.quantile(
        np.nan_to_num(crossings, nan=np.inf, posinf=np.inf), 1 - tail, method="higher"
    )
    return HalvingError(value, float(low), float(high), largest, count)


def _crossing(levels: np.ndarray, curve: np.ndarray, base: float) -> float:
    """Where a curve [L], made monotone, is half-way down to `base`."""
    gain = scipy.optimize.isotonic_regression(curve, increasing=False).x - base
    if gain[0] <= 0:
        return np.nan
    below = np.flatnonzero(gain < gain[0] / 2)
    if not len(below):
        return np.inf
    i = int(below[0])
    part = (gain[i - 1] - gain[0] / 2) / (gain[i - 1] - gain[i])
    return float(levels[i - 1] + part * (levels[i] - levels[i - 1]))
