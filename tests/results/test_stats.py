"""Success rates: hand-computed cases, and coverage of intervals by simulation."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from outcomes import column, rows_of

from jaxcam.results import stats
from jaxcam.results.differences import paired_difference
from jaxcam.results.rows import Row
from jaxcam.results.stats import Estimate, gap_between, latest_rows, success_rate, wilson


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


def test_a_policy_that_gives_no_actions_has_failed():
    """NaN in 40 of 50 episodes is 16 %, not 80 % of the ten that are left."""
    rows = column([1] * 8 + [0] * 42)
    rows[10:] = [replace(row, status="policy") for row in rows[10:]]
    estimate = success_rate(rows)
    assert (estimate.value, estimate.n, estimate.excluded, estimate.broken) == (0.16, 50, 0, 40)
    assert str(estimate).endswith("(n = 50, 40 without actions)")
    difference = paired_difference(rows, column([0] * 50))
    assert (difference.value, difference.pairs, difference.excluded) == (0.16, 50, 0)


def test_where_the_simulator_failed_there_is_no_outcome():
    rows = column([1, 1, 0, 0])
    rows[3] = replace(rows[3], status="simulator", success=None)
    assert (success_rate(rows).value, success_rate(rows).excluded) == (2 / 3, 1)


def test_the_spread_over_seeds_stands_beside_the_interval_over_pairs():
    """Seeds at 0, 50 and 100 %: pairs alone give 50 % within few points."""
    outcomes = np.array([[0, pair % 2, 1] for pair in range(100)])
    estimate = success_rate(rows_of(outcomes))
    assert estimate.high - estimate.low < 0.15
    assert estimate.seeds == (0.0, 0.5, 1.0)
    assert estimate.over_seeds == (0.0, 1.0)
    assert "seeds 0.0 to 100.0, over pairs and seeds [0.0, 100.0]" in str(estimate)
    two = success_rate(rows_of(outcomes[:, :2]))
    assert (two.seeds, two.over_seeds) == ((0.0, 0.5), None)
    assert success_rate(column([1, 0])).seeds == ()


@pytest.mark.parametrize(("seeds", "spread"), [(3, 0.0), (3, 0.5), (5, 0.8)])
def test_an_interval_over_pairs_and_seeds_covers_what_new_ones_give(seeds, spread):
    rng, pairs = np.random.default_rng(1), 30

    def rates(shape, seed_shape):
        odds = 1.5 * rng.normal(size=shape) + spread * rng.normal(size=seed_shape)
        return 1 / (1 + np.exp(-odds))

    truth = rates(400_000, 400_000).mean()
    covered = []
    for _ in range(400):
        outcomes = rng.random((pairs, seeds)) < rates((pairs, 1), (1, seeds))
        moved, of_seeds = outcomes.mean(1), outcomes.mean(0)
        alone = (float(moved.mean()),) * 2
        low, high = stats.with_seeds(alone[0], moved, [of_seeds], alone, (0.0, 1.0))
        covered.append(low <= truth <= high)
    assert np.mean(covered) >= 0.93


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


@pytest.mark.parametrize("way", [{"width": 20}, {"engine": "mjx-warp"}, {"ensemble": 0.01}])
def test_of_an_evaluation_that_was_run_in_two_ways_the_last_counts_alone(way):
    first, second = (Row(pair=p, status="ok", success=True, width=50) for p in (0, 1))
    other = replace(second, **way)
    assert latest_rows([first, second, other]) == [other]
    assert latest_rows([other, first, second]) == [first, second]


def test_rows_of_each_condition_are_kept():
    clean, noisy = (
        [Row(pair=p, status="ok", success=won, eval_pose_noise=noise) for p in range(3)]
        for won, noise in ((True, None), (False, "1,1"))
    )
    again = [replace(row, engine="mjx-warp") for row in noisy]
    assert latest_rows([*clean, *noisy]) == [*clean, *noisy]
    assert latest_rows([*noisy, *clean, *again]) == [*again, *clean]  # ways count within each


def test_of_several_ways_the_last_one_counts_with_all_its_rows():
    """A pair that is run anew in a way counts with those that were run in it before."""
    plain = [Row(pair=pair, status="ok", success=True, engine="native") for pair in range(3)]
    failed = Row(pair=3, status="simulator", engine="native")
    warped = [Row(pair=pair, status="ok", success=False, engine="mjx-warp") for pair in range(4)]
    again = replace(failed, status="ok", success=False)
    assert latest_rows([*plain, failed, *warped]) == warped
    assert latest_rows([*plain, failed, *warped, again]) == [*plain, again]


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


def test_a_gap_of_two_rates_is_newcombes():
    """His example: 56 of 70 against 48 of 80, method 10."""
    a, b = (Estimate(k / n, *wilson(k, n), n, n) for k, n in ((56, 70), (48, 80)))
    gap, low, high = gap_between(a, b)
    assert gap == pytest.approx(0.2)
    assert (low, high) == pytest.approx((0.0524, 0.3339), abs=1e-4)
    assert gap_between(b, a) == pytest.approx((-gap, -high, -low))
