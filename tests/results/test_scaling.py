"""The law of cameras and demonstrations, on cells that follow it and on cells that do not."""

import itertools

import numpy as np
import pytest
from run_rows import evaluation

from jaxcam.results.scaling import fit_scaling, scaling_law

CELLS = np.array([*itertools.product((3, 10, 30, 100, 300), (50, 100, 200))], float)
TRUE = 1 / (1 + 0.1 + 12 * CELLS[:, 0] ** -0.9 + 40 * CELLS[:, 1] ** -0.8)


def drawn(rates, pairs, seed=0):
    """Outcomes [C, pairs] of exactly these rates."""
    hard = np.random.default_rng(seed).permuted(
        np.repeat((np.arange(pairs)[None] + 0.5) / pairs, len(rates), 0), axis=1
    )
    return (hard < rates[:, None]).astype(float)


def test_a_law_that_holds_is_found_and_predicts_what_was_left_out():
    law = fit_scaling(CELLS, drawn(TRUE, 5000))
    assert np.allclose(
        [law.floor.value, law.alpha.value, law.beta.value], [0.1, 0.9, 0.8], atol=0.1
    )
    assert law.error < 0.005
    assert np.allclose(law.at(*CELLS.T), TRUE, atol=0.01)
    assert law.at(1e6, 1e6) == pytest.approx(1 / 1.1, abs=0.02)


def test_the_error_of_few_pairs_is_about_what_chance_gives():
    rng = np.random.default_rng(0)
    coins = [(rng.random((len(CELLS), 100)) < TRUE[:, None]).astype(float) for _ in range(2)]
    laws = [fit_scaling(CELLS, some) for some in coins]
    assert 0.7 < np.mean([law.error / law.by_chance for law in laws]) < 2
    assert all(law.alpha.low <= 0.9 <= law.alpha.high for law in laws)


def test_cells_that_follow_no_such_law_are_predicted_badly():
    odd = np.where(CELLS[:, 0] == 30, 0.05, 0.8)  # falls and rises again
    law = fit_scaling(CELLS, drawn(odd, 200))
    assert law.error > 0.1
    assert law.error > 4 * law.by_chance


def test_more_cameras_that_do_not_help_have_no_exponent():
    flat = 1 / (1 + 40 * CELLS[:, 1] ** -0.8)
    law = fit_scaling(CELLS, drawn(flat, 5000))
    assert law.alpha is None
    assert law.beta.value == pytest.approx(0.8, abs=0.1)
    assert np.allclose(law.at(CELLS[:, 0], 100.0), 1 / (1 + 40 * 100**-0.8), atol=0.02)


@pytest.mark.parametrize("rate", [0.1, 0.5, 0.9])
def test_where_neither_matters_all_that_fails_stays(rate):
    law = fit_scaling(CELLS, drawn(np.full(len(CELLS), rate), 50))
    assert law.alpha is None
    assert law.beta is None
    assert law.floor.value == pytest.approx((1 - rate) / rate, rel=0.01)
    assert law.floor.low < law.floor.value < law.floor.high
    assert np.allclose(law.at(*CELLS.T), rate, atol=0.01)


def test_no_law_of_cells_that_cannot_tell_one():
    def rows(outcomes):
        return {tuple(cell): evaluation(some) for cell, some in zip(CELLS, outcomes, strict=True)}

    coins = np.random.default_rng(0).random((len(CELLS), 50)) < 0.5
    assert scaling_law(rows(coins)) is not None
    assert scaling_law(rows(coins[:, :10])) is None  # few pairs
    assert scaling_law(rows(coins & False)) is None
    assert scaling_law(rows(coins | True)) is None
    rising = {(n, 10 * n): evaluation(some) for n, some in zip(range(1, 9), coins, strict=False)}
    assert scaling_law(rising) is None  # which of the two it is, nobody can say


def test_rows_are_put_together_by_their_pairs():
    rng = np.random.default_rng(0)
    rows = {tuple(cell): evaluation(rng.random(50) < rate)
            for cell, rate in zip(CELLS, TRUE, strict=True)}  # fmt: skip
    law = scaling_law(rows)
    assert law is not None
    assert law.pairs == 50
    assert np.allclose(law.rates, [np.mean([r.success for r in some]) for some in rows.values()])
    few = dict([*rows.items()][:5])
    assert scaling_law(few) is None
    of_one_length = {cell: some for cell, some in rows.items() if cell[1] == 50} | {
        (cameras, 50.0): evaluation(np.ones(50, bool)) for cameras in (1.0, 2.0)}  # fmt: skip
    assert scaling_law(of_one_length) is None
