"""The language model: rotary positions."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxcam.models.smolvla.smollm import rope


def test_rotary_scores_depend_on_distance_only():
    rng = np.random.default_rng(0)
    q, k = (jnp.asarray(rng.normal(size=(1, 1, 1, 16)), jnp.float32) for _ in range(2))

    def score(i, j):
        return float((rope(q, np.array([i])) * rope(k, np.array([j]))).sum())

    assert score(7, 3) == pytest.approx(score(104, 100), abs=1e-4)
    assert abs(score(7, 3) - score(7, 4)) > 1e-2
