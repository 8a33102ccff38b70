"""A results folder has its runs again, all of them or those of one split."""

import pytest
from packs import foreign, ours

from jaxcam.errors import ConfigError
from jaxcam.reports.packs.folder import check_replaces, read_results, results_texts, write_results


def test_runs_are_read_as_they_were_written(tmp_path):
    runs = [*ours(tmp_path / "runs"), foreign(action_space="eef_abs")]
    write_results(tmp_path / "results", runs)
    again = read_results(tmp_path / "results", None)
    assert [run.settings for run in again] == [run.settings for run in runs]
    outcomes = [[(row.pair, row.pair_sha, row.success) for row in run.rows] for run in runs]
    assert [[(r.pair, r.pair_sha, r.success) for r in run.rows] for run in again] == outcomes
    assert all(not run.rows for run in read_results(tmp_path / "results", "validation"))
    assert {run.source for run in again} == {str(tmp_path / "results")}


def test_runs_without_rows_are_left_out():
    assert results_texts([foreign(pairs=0)]) == {"rows.jsonl": "", "runs.json": "[]\n"}


def test_what_would_be_lost_is_told_with_the_flag_that_named_it(tmp_path):
    write_results(tmp_path, [foreign()])
    with pytest.raises(ConfigError, match=r"Give .* too, or choose another --pack"):
        check_replaces(tmp_path, ours(tmp_path / "runs"), "--pack")
