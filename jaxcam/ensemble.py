"""Temporal ensembling: every step executes a mean of all that was ever predicted for it.

The policy is asked at every step; predictions of a step are weighed by exp(-rate * i), where i = 0
is the oldest (Zhao et al., "Learning Fine-Grained Bimanual Manipulation with Low-Cost Hardware").
"""

from typing import NamedTuple

import numpy as np


class Ensemble(NamedTuple):
    """Means for the steps that predictions reach to, the next step first."""

    mean: np.ndarray
    """[B, T, A]."""
    count: np.ndarray
    """Predictions that each mean is of [T]."""


def weights(count: int, rate: float) -> np.ndarray:
    """Weights of `count` predictions of one step, the oldest first; they add up to 1."""
    raw = np.exp(-rate * np.arange(count))
    return raw / raw.sum()


def ensemble(
    before: Ensemble | None, chunk: np.ndarray, rate: float = 0.01
) -> tuple[np.ndarray, Ensemble]:
    """Takes in the chunk predicted now.

    Args:
        before: What the step before left behind; None at the start.
        chunk: Actions from now on [B, T, A]. They must mean the same whenever they are predicted:
            absolute targets, not differences.
        rate: How much less each newer prediction weighs; 0 weighs them the same.

    Returns:
        The action to execute now [B, A], and what to pass on to the next step.
    """
    length = chunk.shape[1]
    mean, count = np.zeros_like(chunk), np.zeros(length, int)
    if before is not None:
        known = before.count.size
        mean[:, :known], count[:known] = before.mean, before.count
    newest = np.exp(-rate * count)
    older = np.array([np.exp(-rate * np.arange(n)).sum() for n in count])
    share = (newest / (older + newest))[:, None]
    mean, count = (1 - share) * mean + share * chunk, count + 1
    return mean[:, 0], Ensemble(mean[:, 1:], count[1:])
