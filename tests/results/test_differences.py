"""Paired differences: by hand, coverage by simulation, null and power of the test, and seeds."""

import numpy as np
import pytest
import scipy.stats
from outcomes import column, rows_of

from jaxcam.results.differences import paired_difference, studentised
from jaxcam.results.rows import Row


def test_paired_difference_by_hand():
    a, b = column([1, 1, 1, 1, 0]), column([0, 0, 0, 0, 0])
    difference = paired_difference(a, b)
    assert difference.value == pytest.approx(0.8)
    # Two pairs are added, 1 and -1: mean 4 / 7, squares 6 / 7, Student's t with 4 degrees.
    error = np.sqrt((6 / 7 - (4 / 7) ** 2) / 7)
    half = scipy.stats.t.ppf(0.975, 4) * error
    assert (difference.low, difference.high) == pytest.approx((4 / 7 - half, 1.0))
    assert difference.p_value == pytest.approx(2 * scipy.stats.t.sf(4 / 7 / error, 4))
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


@pytest.mark.parametrize(("rollouts", "gain"), [(1, 0.0), (3, 0.1), (30, 0.0), (30, 0.1)])
def test_an_interval_is_no_wider_than_it_must_be(rollouts, gain):
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
    assert 0.92 <= np.mean([d.low <= 0 <= d.high for d in null]) <= 0.99
    assert np.mean([d.p_value < 0.05 for d in shifted]) > 0.9


def single(rng, pairs, a=0.3, b=0.1):
    """One rollout a pair: A alone succeeds with the probability a, B alone with b."""
    draw = rng.random(pairs)
    return (draw < a).astype(float) - (draw > 1 - b)


def several(rng, pairs, rollouts=30, gain=0.3, hard=(0.8, 1.2)):
    """Many rollouts a pair, whose difficulty differs from pair to pair."""
    difficulty = rng.beta(*hard, (pairs, 1))
    b = rng.random((pairs, rollouts)) < difficulty
    a = rng.random((pairs, rollouts)) < difficulty + gain * (1 - difficulty)
    return a.mean(1) - b.mean(1)


def near_the_ceiling(rng, pairs):
    """Thirty rollouts on pairs of which a few are hard for each arm alone."""
    rates = (rng.beta(rate, 1 - rate, pairs) for rate in (0.99, 0.95))
    a, b = (rng.binomial(30, rate) / 30 for rate in rates)
    return a - b


WORLDS = {
    "one rollout": (single, {}, 0.2),
    "no difference": (single, {"a": 0.5, "b": 0.5}, 0.0),
    "they seldom differ": (single, {"a": 0.05, "b": 0.02}, 0.03),
    "A alone succeeds": (single, {"a": 0.7, "b": 0.0}, 0.7),
    "A is always better": (single, {"a": 0.95, "b": 0.0}, 0.95),
    "three rollouts": (several, {"rollouts": 3}, 0.3 * 0.6),
    "thirty rollouts": (several, {}, 0.3 * 0.6),
    "few pairs differ, and by all": (
        lambda rng, pairs: np.where(rng.random(pairs) < 0.3, 1.0, rng.choice([-0.05, 0.05], pairs)),
        {},
        0.3,
    ),
    "thirty on easy and hard pairs": (several, {"gain": 0.5, "hard": (0.1, 0.3)}, 0.5 * 0.75),
    "thirty, nearly all succeed": (near_the_ceiling, {}, 0.04),
}


@pytest.mark.parametrize("pairs", [5, 10, 15, 20, 30, 50])
@pytest.mark.parametrize("world", WORLDS)
def test_an_interval_covers_the_truth_from_five_pairs_on(world, pairs):
    draw, how, truth = WORLDS[world]
    rng, count = np.random.default_rng(5), 600
    ends = [studentised(draw(rng, pairs, **how)) for _ in range(count)]
    covered = np.mean([low - 1e-9 <= truth <= high + 1e-9 for low, high, _ in ends])
    assert covered >= 0.93


def test_interval_and_p_never_contradict_each_other():
    rng = np.random.default_rng(8)
    for pairs in (2, 3, 5, 10, 15, 40, 200):
        for _ in range(200):
            draw = single if rng.random() < 0.5 else several
            low, high, p_value = studentised(draw(rng, pairs))
            assert (low > 0 or high < 0) == (p_value < 0.05)
            assert 0 <= p_value <= 1


def test_the_line_of_the_issue_says_one_thing():
    """Forty pairs, 16 to 5: once "+27.5 [+2.5, +50.0]" beside p = 0.052."""
    deltas = np.array([1] * 16 + [-1] * 5 + [0] * 19)
    low, _, p_value = studentised(deltas)
    assert (low > 0) == (p_value < 0.05)
    assert p_value == pytest.approx(scipy.stats.binomtest(5, 21).pvalue, abs=0.03)


def test_fewer_than_two_pairs_say_nothing():
    assert studentised(np.array([1.0])) == (-1.0, 1.0, 1.0)


def test_seeds_stand_beside_the_pairs():
    """Three seeds that fail, win half and win all on the same pairs, against failures."""
    a = rows_of(np.array([[0, pair % 2, 1] for pair in range(40)]))
    b = rows_of(np.zeros((40, 3)))
    difference = paired_difference(a, b)
    assert difference.seeds == (0.0, 0.5, 1.0)
    assert difference.over_seeds == (-0.0, 1.0) or difference.over_seeds[0] <= 0
    assert difference.over_seeds[1] == 1.0
    assert "seeds +0.0 to +100.0, over pairs and seeds [" in str(difference)
    assert paired_difference(a, column([0] * 40)).over_seeds is None  # one seed of B
    assert paired_difference(a, column([0] * 40)).seeds == ()


def test_pairs_of_either_arm_alone_are_counted():
    def rows(pairs):
        return [Row(pair=pair, seed=0, status="ok", success=True) for pair in pairs]

    for few, many in (([0, 1], [1, 2, 3]), ([1, 2, 3], [0, 1])):
        delta = paired_difference(rows(few), rows(many))
        assert (delta.pairs, delta.unpaired) == (1, 3)
