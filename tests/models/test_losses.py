"""Losses over chunks that end before they are full."""

import jax.numpy as jnp
import pytest

from jaxcam.models.losses import padded_mean, repeat_ends


@pytest.mark.parametrize(
    ("rule", "expected"),
    [("counted", 10 / 8), ("zeroed", 6 / 8), ("valid", 6 / 6), ("sample", (0.5 + 4 / 2) / 2)],
)
def test_padding_rules(rule, expected):
    error = jnp.array([[0.0, 0.0, 1.0, 1.0], [2.0, 2.0, 2.0, 2.0]])[..., None]
    is_pad = jnp.array([[False] * 4, [False, False, True, True]])
    assert float(padded_mean(error, is_pad, rule)) == pytest.approx(expected)


def test_padding_repeats_the_last_step_before_it_or_the_first():
    x = jnp.arange(15.0).reshape(3, 5, 1)
    is_pad = jnp.array([[1, 0, 0, 0, 0], [0, 0, 1, 1, 1], [1, 1, 0, 1, 0]], bool)
    expected = [[1, 1, 2, 3, 4], [5, 6, 6, 6, 6], [12, 12, 12, 12, 14]]
    assert repeat_ends(x, is_pad)[..., 0].tolist() == expected
