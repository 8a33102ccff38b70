"""Errors of poses in reports: every level is an arm, beside the image-only policy, and no other."""

import pytest
from made_runs import arms_of, make_run
from run_rows import evaluation

from jaxcam.reports.axes.pose_errors import error_curves, over_errors, pose_error_blocks
from jaxcam.reports.comparison import write_comparison
from jaxcam.reports.document import Table
from jaxcam.reports.reading import read_runs

PAIRS = 20


def told_wrong(config, rate, pair_rows=PAIRS, **conditions):
    named = {"policy": "act", "scene": "randomized", "split": "test", "width": 50, "run": config}
    wins = [i < rate * pair_rows for i in range(pair_rows)]
    rows = evaluation(wins, conditioning="late", **{**named, "step": 4000}, **conditions)
    return [row.to_json() | {"pair_sha": f"{row.pair:016x}"} for row in rows]


@pytest.fixture
def runs(tmp_path):
    levels = {"1,0": 0.8, "2,0": 0.5, "4,0": 0.2, "0,1": 0.8, "1,1": 0.7, "2,2": 0.4}
    rows = [r for at, rate in levels.items() for r in told_wrong("late", rate, eval_pose_noise=at)]
    rows += told_wrong("late", 0.5, eval_pose_drift="1,1")
    make_run(tmp_path / "late", conditioning="late", rate=0.8, pairs=PAIRS, rows=rows)
    twin = {"conditioning": "none", "model": ("twin_of=late",)}
    make_run(tmp_path / "none", rate=0.1, pairs=PAIRS, **twin)
    return tmp_path


def test_each_level_is_an_arm_of_one_curve(runs):
    noise, drift = error_curves(arms_of(runs))
    assert set(noise.arms) == {(0, 0), (1, 0), (2, 0), (4, 0), (0, 1), (1, 1), (2, 2)}
    assert noise.clean.estimate.value == 0.8
    assert noise.image_only.estimate.value == 0.1
    assert [*noise.along("rotation")] == [0, 1, 2, 4]
    assert [*noise.along("both")] == [0, 1, 2]
    assert noise.arms[2, 0].estimate.value == 0.5
    assert set(drift.arms) == {(0, 0), (1, 1)}
    assert drift.field == "eval_pose_drift"


def test_the_report_draws_them_and_says_what_halves_the_gain(runs, tmp_path):
    blocks = pose_error_blocks(arms_of(runs), tmp_path / "out")
    tables = [block for block in blocks if isinstance(block, Table)]
    # Gains of 0.7, 0.4 and 0.1 at 1, 2 and 4 degrees: half of 0.7 is at 2 + 2 * 0.05 / 0.3.
    assert tables[0].rows[0][5].startswith("2.3 [")
    assert (tmp_path / "out/figures/pose_noise.png").is_file()
    assert (tmp_path / "out/figures/pose_drift.png").is_file()
    page = write_comparison(read_runs([runs]), tmp_path / "report")
    text = (page.parent / "report.md").read_text("utf-8")
    assert "Errors of the poses that policies are told" in text
    again = write_comparison(read_runs([page.parent]), tmp_path / "again")
    assert (again.parent / "report.csv").read_text("utf-8") == (
        page.parent / "report.csv"
    ).read_text("utf-8")


def test_policies_that_differ_in_what_their_errors_are_drawn_for_are_told_apart(tmp_path):
    levels = {"1,1": 0.7, "2,2": 0.4}
    for per in ("sample", "episode"):
        rows = [r for at, rate in levels.items() for r in told_wrong(per, rate, eval_pose_noise=at)]
        trained = {"conditioning": "late", "pose_noise": "1,1", "pose_noise_per": per}
        make_run(tmp_path / per, rate=0.8, pairs=PAIRS, rows=rows, **trained)
    figure = over_errors(error_curves(arms_of(tmp_path)))
    (legend,) = figure.legends
    handles = legend.legend_handles
    assert len({(h.get_linestyle(), h.get_marker(), h.get_color()) for h in handles}) == 2
    axes = figure.axes[-1]
    assert {h.get_marker() for h in handles} == {line.get_marker() for line in axes.lines}


def test_policies_of_one_name_are_told_apart_by_the_rest(tmp_path):
    """Two that were trained with the same errors, for 4000 and for 2000 updates, were one."""
    for steps in (2000, 4000):
        rows = told_wrong(str(steps), 0.5, eval_pose_noise="1,1")
        trained = {"conditioning": "late", "pose_noise": "1,1", "steps": steps}
        make_run(tmp_path / str(steps), rate=0.8, pairs=PAIRS, rows=rows, **trained)
    (legend,) = over_errors(error_curves(arms_of(tmp_path))).legends
    names = [text.get_text() for text in legend.get_texts()]
    assert len(names) == 2
    assert any("steps 4000" in name for name in names)


def test_without_such_rows_nothing_is_said(tmp_path):
    make_run(tmp_path / "late", conditioning="late")
    assert pose_error_blocks(arms_of(tmp_path), tmp_path) == []
