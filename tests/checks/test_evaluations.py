"""What the doctor says of a run's evaluations."""

import shutil

import pytest
from checked_run import row, write

from jaxcam.checks.evaluations import check_evaluations

PAIRS = 3


@pytest.fixture
def run(tmp_path):
    """A run's folder with nothing but one whole evaluation."""
    (tmp_path / "eval").mkdir()
    write(tmp_path / "eval" / "rows.jsonl", [row(2, pair) for pair in range(PAIRS)])
    return tmp_path


def test_a_whole_evaluation(run):
    (finding,) = check_evaluations(run, PAIRS)
    assert finding.mark == "good"
    assert (finding.got, finding.where) == ("3 of 3 pairs have an outcome", "test, step 2")


EVALUATIONS = {
    "a rollout that failed": (
        lambda r: write(r / "eval" / "rows.jsonl",
                        [row(2, 0), row(2, 1), row(2, 2, status="error", success=False)]),
        "note", "2 of 3 pairs have an outcome; 1 ended in an error of the simulator",
    ),
    "a rollout twice": (
        lambda r: write(r / "eval" / "rows.jsonl", [row(2, p) for p in (0, 1, 2, 1)]),
        "bad", "1 rollouts have several outcomes",
    ),
    "no actions": (
        lambda r: write(r / "eval" / "rows.jsonl",
                        [row(2, 0), row(2, 1), row(2, 2, status="policy", success=False)]),
        "good", "3 of 3 pairs have an outcome; in 1 the policy gave no actions",
    ),
    "rows of other weights": (
        lambda r: write(r / "eval" / "rows.jsonl",
                        [row(2, p, weights_sha=f"{p // 2:016x}") for p in range(3)]),
        "bad", "line 3: this row of pair 2 at step 2 is not of this run (weights",
    ),
    "no evaluation": (lambda r: shutil.rmtree(r / "eval"), "note", "none yet"),
}  # fmt: skip


@pytest.mark.parametrize("case", EVALUATIONS)
def test_what_is_wrong_with_an_evaluation(run, case):
    change, mark, words = EVALUATIONS[case]
    change(run)
    first = next(iter(check_evaluations(run, PAIRS)))
    assert first.mark == mark, first
    assert words in first.got


def test_an_evaluation_that_was_stopped_says_how_to_go_on(run):
    write(run / "eval" / "rows.jsonl", [row(1, pair) for pair in range(PAIRS)] + [row(2, 0)])
    (finding,) = (f for f in check_evaluations(run, PAIRS) if f.mark == "note")
    assert (finding.got, finding.where) == ("1 of 3 pairs have an outcome", "test, step 2")
    assert f"python -m jaxcam.evaluate {run} --split test --step 2 --pairs 3" in finding.fix
