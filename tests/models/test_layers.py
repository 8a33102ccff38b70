"""Layers that models share."""

import jax
import jax.numpy as jnp
import pytest

from jaxcam.models.layers import dropout


def test_dropout_drops_its_share_and_keeps_the_mean():
    x = jnp.ones((500, 1000))
    y = dropout(x, 0.1, jax.random.key(0))
    assert float((y == 0).mean()) == pytest.approx(0.1, abs=3e-3)
    assert float(y.mean()) == pytest.approx(1, abs=3e-3)
    assert dropout(x, 0.1, None) is x
