"""Rows of trials: written, read, and as_rows."""

import pytest

from jaxcam.errors import DatasetError
from jaxcam.results.stats import success_rate
from jaxcam.robot.trials.order import rollouts
from jaxcam.robot.trials.rows import TrialRow, append_row, as_rows, done, read_trial_rows, shared
from jaxcam.robot.trials.sheet import CamerasEntry, PolicyEntry, Sheet

CAMERAS = CamerasEntry(("a", "b", "c"), 2, "cameras.json", ("1", "2"))
SHEET = Sheet(
    "t", "s", "h", (PolicyEntry("x", "ws://x"), PolicyEntry("y", "ws://y")), ("here",), CAMERAS
)
PLANNED = rollouts(SHEET)


def row(number, outcome, **values):
    planned = PLANNED[number - 1]
    condition = planned.condition
    return TrialRow(
        number=number, policy=planned.letter, placement=condition.placement,
        cameras=condition.cameras, start=condition.start, outcome=outcome, **values,
    )  # fmt: skip


def test_rows_come_back_as_they_were(tmp_path):
    rows = [row(1, "half", comment="slipped", calibration={"a": {"K": [[1.0]]}}), row(2, "redo")]
    for one in rows:
        append_row(tmp_path / "rows.jsonl", one)
    assert read_trial_rows(tmp_path / "rows.jsonl", PLANNED) == rows
    assert "x" not in (tmp_path / "rows.jsonl").read_text().split('"')  # no policy's name


def test_a_line_that_was_torn_off_is_run_again_and_a_damaged_one_is_refused(tmp_path):
    file = tmp_path / "rows.jsonl"
    append_row(file, row(1, "half"))
    file.write_text(file.read_text() + '{"number": 2, "pol')
    assert [one.number for one in read_trial_rows(file, PLANNED)] == [1]
    append_row(file, row(2, "failure"))
    assert [one.number for one in read_trial_rows(file, PLANNED)] == [1, 2]
    file.write_text(file.read_text().replace('"number": 1', '"number": 99'))
    with pytest.raises(DatasetError, match=r"line 1: rollout 99; the sheet has 1 to 12"):
        read_trial_rows(file, PLANNED)


def test_the_last_row_of_a_rollout_counts_unless_it_is_run_again():
    rows = [row(1, "half"), row(1, "redo"), row(2, "redo"), row(2, "success")]
    assert {number: one.outcome for number, one in done(rows).items()} == {2: "success"}


def test_placements_are_the_clusters_and_half_counts_where_it_is_asked_for():
    outcomes = ["success", "half", "failure"] * 4
    rated = done([row(i, outcome) for i, outcome in enumerate(outcomes, start=1)])
    for policy in (0, 1):
        mine = [r for r in PLANNED if r.policy == policy]
        whole = success_rate(as_rows(SHEET, PLANNED, rated, policy, "whole"))
        half = success_rate(as_rows(SHEET, PLANNED, rated, policy, "half"))
        of = [rated[r.number].outcome for r in mine]
        assert whole.value == of.count("success") / 6
        assert half.value == 1 - of.count("failure") / 6
        assert (whole.n, whole.clusters) == (6, 2)


def test_only_conditions_that_all_have_met_are_compared():
    rated = done([row(number, "half") for number in (1, 2, 3)])
    assert list(shared(PLANNED, rated)) == [1, 2]
