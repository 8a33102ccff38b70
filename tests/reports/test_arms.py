"""Which rows of an arm count, and what it is called."""

import pytest
from made_runs import arms_of, make_run
from packs import foreign

from jaxcam.reports.arms import Arm, group, kind_of_pairs


def test_a_whole_protocol_counts_and_anything_less_is_told(tmp_path):
    for seed in range(3):
        make_run(tmp_path / f"w{seed}", seed=seed, checkpoints=10, pairs=50, save_every=100)
        make_run(tmp_path / f"l{seed}", seed=seed, checkpoints=9 + (seed > 0), pairs=50,
                 save_every=100, conditioning="late")  # fmt: skip
    whole, less = arms_of(tmp_path)[::-1]
    assert (whole.lacks, whole.count(), whole.estimate.n) == ([], "1500", 1500)
    assert (less.lacks, less.count()) == (["9 of 10 checkpoints"], "1450 of 1500")
    assert whole.estimate.clusters == 50


def test_the_newest_checkpoints_count_with_the_protocols_pairs(tmp_path):
    make_run(tmp_path / "a", checkpoints=12, pairs=60, save_every=100)
    (arm,) = arms_of(tmp_path)
    assert sorted({row.step for row in arm.rows}) == [*range(1100, 2001, 100)]
    assert max(row.pair for row in arm.rows) == 49


def test_an_arm_of_somebody_elses_policy_is_whole_with_the_pairs_of_one():
    (arm,) = group([foreign("OpenVLA 7B", rate=0.5, pairs=50, action_space="eef_abs", weights="")])
    assert (arm.lacks, arm.count()) == ([], "50")
    assert arm.label() == "settings of its own, action_space eef_abs"
    (few,) = group([foreign(pairs=8)])
    assert few.count() == "8 of 50"


def test_settings_that_nobody_recorded_are_said_to_be_so():
    run = foreign("act", way="late", engine="mjx-warp", ensemble=0.0, views=1)
    assert Arm((run,)).label() == "settings not recorded, engine mjx-warp"


@pytest.mark.parametrize(
    ("settings", "views"),
    [({}, 1), ({"views": 2}, 2), ({"task": "square"}, 2), ({"task": "x"}, None)],
)
def test_pairs_have_the_tasks_cameras_where_nobody_says_another_number(settings, views):
    known = {"task": "lift", "scene": "fixed"} | settings
    assert kind_of_pairs(known) == (known["task"], "fixed", views)
