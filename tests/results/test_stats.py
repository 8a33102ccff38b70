"""Statistics: hand-computed cases, interval coverage by simulation, null and power of the test."""

import functools
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from jaxcam.results import stats
from jaxcam.results.rows import Row
from jaxcam.results.stats import Estimate, latest_rows, paired_difference, success_rate, wilson


@functools.cache
def row_of(pair, seed, success, **fields):
    """Simulations ask for the same rows hundreds of times."""
    return Row(pair=pair, seed=seed, success=success, status="ok", **fields)


def rows_of(outcomes, **fields):
    """Finished rows; outcomes[pair, seed]."""
    return [
        row_of(pair, seed, bool(value), **fields)
        for pair, of_pair in enumerate(np.atleast_2d(outcomes))
        for seed, value in enumerate(of_pair)
    ]


def column(outcomes, **fields):
    """One row a pair."""
    return rows_of(np.asarray(outcomes)[:, None], **fields)


@pytest.fixture
def few_resamples(monkeypatch):
    """Enough for a simulation over hundreds of data sets."""
    monkeypatch.setattr(stats, "RESAMPLES", 400)


def test_wilson_against_hand_computed_values():
    assert wilson(50, 100) == pytest.approx((0.40383, 0.59617), abs=1e-5)
    assert wilson(0, 10) == pytest.approx((0.0, 0.27753), abs=1e-5)
    assert wilson(10, 10) == pytest.approx((0.72247, 1.0), abs=1e-5)
    assert wilson(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize(("successes", "n"), [(0, 7), (3, 7), (199, 200)])
def test_wilson_is_scipys_for_whole_counts_and_lies_between_for_others(successes, n):
    known = scipy.stats.binomtest(successes, n).proportion_ci(method="wilson")
    assert wilson(successes, n) == pytest.approx((known.low, known.high))
    assert wilson(successes, n) < wilson(successes + 0.5, n) < wilson(successes + 1, n)


def test_numbers_are_the_same_from_run_to_run():
    rng = np.random.default_rng(2)
    a, b = (rows_of(rng.random((40, 3)) < p) for p in (0.4, 0.6))
    assert success_rate(a) == success_rate(list(a))
    assert paired_difference(a, b) == paired_difference(list(a), list(b))


def test_p_values_that_are_sampled_are_those_of_all_patterns():
    """Thirteen differences are one more than are enumerated."""
    deltas = np.array([1, 1, 1, 1, 1, 1, 1, 1, 1, 1, -1, -1, -1])
    a, b = column(deltas > 0), column(deltas < 0)
    exact = scipy.stats.binomtest(3, 13).pvalue
    assert paired_difference(a, b).p_value == pytest.approx(exact, abs=0.01)
    assert paired_difference(a[1:], b[1:]).p_value == scipy.stats.binomtest(3, 12).pvalue


def test_a_single_pair_says_next_to_nothing():
    estimate = success_rate(rows_of([[1, 1, 1, 0]]))
    assert (estimate.value, estimate.clusters) == (0.75, 1)
    assert estimate.high == pytest.approx(0.75 + 0.25 * wilson(0, 1)[1])
    assert paired_difference(column([1]), column([0])).p_value == 1.0


@pytest.mark.parametrize(("successes", "n"), [(-1, 5), (6, 5), (0, -1)])
def test_wilson_refuses_impossible_counts(successes, n):
    with pytest.raises(ValueError, match="successes"):
        wilson(successes, n)


def test_estimate_reads_as_in_a_table():
    assert str(Estimate(0.43, 0.361, 0.502, 200, 200)) == "43.0 % [36.1, 50.2] (n = 200)"
    text = str(Estimate(0.43, 0.361, 0.502, 600, 200, excluded=3))
    assert text == "43.0 % [36.1, 50.2] (n = 600 on 200 pairs, 3 excluded)"


def test_one_row_a_pair_is_the_ordinary_bootstrap():
    estimate = success_rate(column([1] * 86 + [0] * 114))
    assert (estimate.value, estimate.n, estimate.clusters) == (0.43, 200, 200)
    half = 1.96 * np.sqrt(0.43 * 0.57 / 200)
    assert (estimate.low, estimate.high) == pytest.approx((0.43 - half, 0.43 + half), abs=0.006)


def test_repeating_a_rollout_does_not_narrow_the_interval():
    outcomes = np.array([1] * 20 + [0] * 30)[:, None]
    once = success_rate(rows_of(outcomes))
    thirty_times = success_rate(rows_of(outcomes.repeat(30, axis=1)))
    assert thirty_times.n == 1500
    assert thirty_times.clusters == 50
    assert (thirty_times.low, thirty_times.high) == pytest.approx((once.low, once.high))


def test_unequal_clusters_pool_the_rollouts():
    rows = rows_of([[1, 1, 1]]) + [replace(row, pair=1) for row in rows_of([[0]])]
    assert success_rate(rows).value == 0.75


@pytest.mark.parametrize(("outcome", "successes"), [(0, 0), (1, 50)])
def test_without_spread_the_interval_is_wilsons(outcome, successes):
    estimate = success_rate(column([outcome] * 50))
    assert (estimate.low, estimate.high) == pytest.approx(wilson(successes, 50))


def test_one_success_is_no_surer_than_none():
    none, one = success_rate(column([0] * 50)), success_rate(column([1] + [0] * 49))
    assert one.low == 0.0
    assert one.high > none.high


def test_errors_are_excluded_and_counted():
    rows = column([1, 0, 1, 0])
    rows[0] = replace(rows[0], status="error")
    rows[1] = replace(rows[1], success=None)
    estimate = success_rate(rows)
    assert (estimate.value, estimate.n, estimate.excluded) == (0.5, 2, 2)
    difference = paired_difference(rows, column([0, 0, 0, 0]))
    assert (difference.value, difference.pairs) == (0.5, 2)
    assert (difference.unpaired, difference.excluded) == (2, 2)


def test_nothing_finished_is_not_a_rate():
    estimate = success_rate([Row(pair=0, status="error")])
    assert np.isnan(estimate.value)
    assert (estimate.low, estimate.high) == (0.0, 1.0)
    assert str(estimate) == "no finished rollouts (n = 0, 1 excluded)"
    assert paired_difference([], []).p_value == 1.0


def test_same_pair_number_in_two_tasks_is_two_clusters():
    rows = column([1, 0], task="lift") + column([1, 0], task="square")
    assert success_rate(rows).clusters == 4


def test_a_rerun_replaces_the_failed_attempt():
    failed = Row(pair=0, seed=0, step=10, status="error")
    again = replace(failed, status="ok", success=True)
    later = replace(again, step=20)
    assert latest_rows([failed, again, later]) == [again, later]


def test_paired_difference_by_hand():
    a, b = column([1, 1, 1, 1, 0]), column([0, 0, 0, 0, 0])
    difference = paired_difference(a, b)
    assert difference.value == pytest.approx(0.8)
    assert difference.p_value == pytest.approx(2 / 16)  # 4 non-zero differences, all one sign
    assert paired_difference(b, a).value == pytest.approx(-0.8)


def test_seeds_are_averaged_inside_each_pair():
    a = rows_of([[1, 1, 0], [0, 0, 0], [1, 1, 1]])
    difference = paired_difference(a, column([0, 0, 1]))
    assert difference.pairs == 3
    assert difference.value == pytest.approx((2 / 3 + 0 + 0) / 3)


def test_equal_arms_keep_some_doubt():
    difference = paired_difference(column([1] * 50), column([1] * 50))
    assert (difference.value, difference.p_value) == (0.0, 1.0)
    assert difference.low < -0.05
    assert difference.high > 0.05


def test_difference_reads_as_in_a_table():
    text = str(paired_difference(column([1] * 30 + [0] * 70), column([0] * 100)))
    assert text.startswith("+30.0 points [+2")
    assert text.endswith("(p < 0.001, 100 pairs)")


def clustered_outcomes(rng, pairs, seeds):
    """Difficulty differs strongly from pair to pair: mean 0.4, large correlation inside a pair."""
    difficulty = rng.beta(0.4, 0.6, pairs)
    return rng.random((pairs, seeds)) < difficulty[:, None]


@pytest.mark.usefixtures("few_resamples")
@pytest.mark.parametrize("seeds", [1, 6, 30])  # 30: 3 seeds with 10 checkpoints each
def test_interval_covers_the_truth(seeds):
    rng = np.random.default_rng(7)
    estimates = [success_rate(rows_of(clustered_outcomes(rng, 60, seeds))) for _ in range(500)]
    covered = np.mean([e.low <= 0.4 <= e.high for e in estimates])
    assert 0.92 <= covered <= 0.98
    if seeds > 1:  # pretending that rollouts are independent must be visibly wrong here
        naive = [wilson(e.value * e.n, e.n) for e in estimates]
        assert np.mean([low <= 0.4 <= high for low, high in naive]) < 0.85


@pytest.mark.usefixtures("few_resamples")
@pytest.mark.parametrize(("rollouts", "gain"), [(1, 0.0), (3, 0.1), (30, 0.0), (30, 0.1)])
def test_difference_interval_covers_the_truth_and_is_no_wider_than_it_must(rollouts, gain):
    rng = np.random.default_rng(3)
    truth = gain * (1 - 0.4)
    differences = []
    for _ in range(400):
        difficulty = rng.beta(0.8, 1.2, (50, 1))
        b = rng.random((50, rollouts)) < difficulty
        a = rng.random((50, rollouts)) < difficulty + gain * (1 - difficulty)
        differences.append(paired_difference(rows_of(a), rows_of(b)))
    covered = np.mean([d.low - 1e-9 <= truth <= d.high + 1e-9 for d in differences])
    assert 0.91 <= covered <= 0.985
    width = np.mean([d.high - d.low for d in differences])
    spread = np.std([d.value for d in differences])
    assert width == pytest.approx(2 * 1.96 * spread, rel=0.15)


@pytest.mark.usefixtures("few_resamples")
def test_difference_interval_null_p_values_and_power():
    rng = np.random.default_rng(11)
    null, shifted = [], []
    for _ in range(300):
        difficulty = rng.beta(0.8, 1.2, (60, 1))
        a, b = rng.random((2, 60, 3)) < difficulty
        better = rng.random((60, 3)) < np.minimum(difficulty + 0.2, 1)
        null.append(paired_difference(rows_of(a), rows_of(b)))
        shifted.append(paired_difference(rows_of(better), rows_of(b)))
    for level in (0.05, 0.1, 0.2, 0.5):  # uniform: a share `level` of p-values lies below it
        rejected = np.mean([d.p_value <= level for d in null])
        noise = 3 * np.sqrt(level * (1 - level) / len(null))
        # Differences come in thirds, so the last steps of the distribution are coarse.
        assert rejected == pytest.approx(level, abs=noise + 0.02), level
    assert 0.92 <= np.mean([d.low <= 0 <= d.high for d in null]) <= 0.98
    assert np.mean([d.p_value < 0.05 for d in shifted]) > 0.9
