"""Warnings of gradients that explode while they are finite."""

import collections
import logging
import statistics
from collections.abc import Mapping

import numpy as np

EXPLODED = 100
"""Times its usual size at which a gradient is worth a warning."""

_log = logging.getLogger(__name__)


class GradientWatch:
    """Compares the norm of a run's gradient with what it usually is.

    Args:
        seed: Of the run, for the message.
    """

    def __init__(self, seed: int) -> None:
        self._seed, self._norms = seed, collections.deque[float](maxlen=20)

    def look(self, row: Mapping[str, float]) -> None:
        """Look at a row of metrics, and warn if its `grad_norm` is far above those before it."""
        norm = row["grad_norm"]
        if len(self._norms) > 4 and norm > EXPLODED * (usual := statistics.median(self._norms)):
            _log.warning(
                "Seed %d: around update %d the gradient's norm is %.3g, %.0f times the usual "
                "%.3g: a lower --lr or --clip-norm may help.",
                self._seed, row["step"], norm, norm / usual, usual,
            )  # fmt: skip
        if np.isfinite(norm):
            self._norms.append(norm)
