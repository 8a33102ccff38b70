"""The error that halves a gain, on curves whose half is known, and how often it is covered."""

import numpy as np
from run_rows import evaluation

from jaxcam.results.halving import halving, halving_error

LEVELS = np.array([0.0, 1, 2, 4, 8])


def chances(levels, half, top=0.9, base=0.1):
    """Success that falls with the error, half of the gain at `half`."""
    return base + (top - base) * 0.5 ** ((np.asarray(levels) / half) ** 2)


def drawn(rng, pairs, half, base=0.1):
    u = rng.random((len(LEVELS) + 1, pairs)) * 0.5 + rng.random(pairs) * 0.5  # pairs are alike
    u = np.argsort(np.argsort(u, 1), 1) / pairs
    return u[:-1] < chances(LEVELS, half, base=base)[:, None], u[-1] < base


def test_a_line_is_halved_in_its_middle():
    outcomes = np.repeat([[0.9], [0.7], [0.5], [0.3], [0.1]], 20, 1)
    result = halving(np.arange(5.0), outcomes, np.full(20, 0.1))
    assert np.isclose(result.value, 2)
    assert np.allclose([result.low, result.high], 2)
    assert result.pairs == 20
    assert str(result) == "2 [2, 2] (20 pairs)"


def test_a_bump_is_no_crossing():
    outcomes = np.repeat([[0.9], [0.45], [0.9], [0.4], [0.1]], 20, 1)
    result = halving(np.arange(5.0), outcomes, np.full(20, 0.1))
    assert 2 < result.value < 3  # 0.45 and 0.9 are averaged to 0.675


def test_what_is_never_halved_and_what_was_never_gained():
    flat = np.ones((5, 30))
    result = halving(LEVELS, flat, np.zeros(30))
    assert np.isinf(result.value)
    assert str(result) == "> 8 [inf, > 8] (30 pairs)"
    result = halving(LEVELS, np.zeros((5, 30)), np.zeros(30))
    assert np.isnan(result.value)
    assert "no gain" in str(result)
    assert result.low == 0
    assert np.isinf(result.high)
    assert halving(LEVELS, np.zeros((5, 0)), np.zeros(0)).pairs == 0


def test_the_interval_has_the_true_error_about_as_often_as_it_says():
    rng, half, hits, values = np.random.default_rng(0), 3.0, 0, []
    truth = halving(LEVELS, chances(LEVELS, half)[:, None], np.array([0.1])).value
    for _ in range(20):
        result = halving(LEVELS, *drawn(rng, 100, half))
        hits += result.low <= truth <= result.high
        values.append(result.value)
    assert abs(np.median(values) - truth) < 0.3
    assert hits >= 17


def test_rows_are_matched_by_pair():
    def rows(successes):
        return evaluation(successes)

    curve = [(2.0, rows([0, 0, 0, 0, 1])), (0.0, rows([1, 1, 1, 1])), (1.0, rows([1, 1, 0, 0]))]
    result = halving_error(curve, rows([0, 0, 0, 0]))
    assert result.pairs == 4
    assert result.value == 1.0
    assert result.largest == 2.0
