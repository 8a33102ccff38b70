"""How much is evaluated, what of it counts, and what is lacking."""

from dataclasses import replace

from jaxcam.config.names import PolicyName, names_of
from jaxcam.results.protocol import (
    NOT_RECORDED,
    Protocol,
    counted,
    is_foreign,
    lacks,
    protocol_of,
)
from jaxcam.results.rows import Row


def rows_at(step, pairs):
    """Successes at one checkpoint."""
    return [Row(task="lift", step=step, pair=p, status="ok", success=True) for p in range(pairs)]


def test_numbers_of_the_paper():
    protocol = protocol_of("act")
    assert protocol.rollouts == 1500
    assert protocol_of("smolvla").rollouts == 500
    assert protocol.steps(4000, 400) == [*range(4000, 0, -400)]
    assert protocol.steps(1000, 300) == [1000, 900, 600, 300]


def test_of_somebody_elses_policy_there_is_one_set_of_weights():
    assert protocol_of("OpenVLA 7B") == Protocol(seeds=1, checkpoints=1, pairs=50)
    assert not any(map(is_foreign, (*names_of(PolicyName), NOT_RECORDED)))
    assert protocol_of(NOT_RECORDED) == protocol_of("act")


def test_what_counts_and_what_is_lacking():
    one = rows_at(40, 5)
    both = one + rows_at(20, 3)
    small = Protocol(seeds=2, checkpoints=2, pairs=3)
    assert counted(one, small) == one  # a single checkpoint counts with all its pairs
    assert [(r.step, r.pair) for r in counted(both, small)] == [
        (step, pair) for step in (20, 40) for pair in range(3)
    ]
    assert lacks([counted(both, small)] * 2, small, 40) == []
    assert lacks([counted(both, small)], small, 40) == ["1 of 2 seeds"]
    assert lacks([counted(both, small), one], small, 40) == ["1 of 2 checkpoints"]
    assert lacks([both[:-1]] * 2, small, 40) == ["2 of 3 pairs"]
    failed = [*both[:-1], replace(both[-1], status="error")]
    assert lacks([failed] * 2, small, 40) == ["2 of 3 pairs"]
    assert lacks([counted(both, small)] * 2, small, 80) == ["trained for 40 of 80 updates"]
    assert lacks([[]], small, 40) == ["not evaluated"]


def test_what_was_seen_in_training_is_no_result():
    small = Protocol(seeds=1, checkpoints=1, pairs=3)
    known = [replace(row, split="train") for row in rows_at(40, 3)]
    assert lacks([rows_at(40, 3)], small, 40) == []
    assert lacks([known], small, 40) == ["on cameras that training saw: no result"]


def test_a_setting_is_trained_as_long_as_the_seed_that_is_least():
    small = Protocol(seeds=2, checkpoints=1, pairs=3)
    assert lacks([rows_at(40, 3), rows_at(20, 3)], small, 40) == ["trained for 20 of 40 updates"]
    assert lacks([rows_at(20, 3), rows_at(40, 3)], small, 40) == ["trained for 20 of 40 updates"]
    assert lacks([rows_at(40, 3), rows_at(40, 3)], small, 40) == []
