"""Table I, and gains over the image-only twin."""

import re

from made_runs import arms_of, make_run
from packs import foreign

from jaxcam.reports import paper
from jaxcam.reports.arms import group
from jaxcam.reports.tables import (
    foreign_table,
    gains_table,
    paper_value,
    runs_table,
    table_one,
    without_twins,
)
from jaxcam.results.differences import paired_difference


def test_table_one_has_the_papers_numbers_beside_ours(runs):
    table = table_one(arms_of(runs))
    assert list(table.head[2:]) == list(paper.TASKS.values())
    assert table.rows[0] == ["ACT", "paper", "33.6", "26.7", "10.8", "29.9", "22.9", "28.7"]
    ours, theirs, conditioned = table.rows[1:4]
    assert ours[1] == "ours\nlaptop preset, twin of late"
    assert re.fullmatch(r"25\.0\n\[\d+\.\d, \d+\.\d\]\nn = 8 of 1500", ours[2])
    assert ours[3:] == ["–"] * 5
    assert theirs[:3] == ["ACT\nw. conditioning", "paper", "60.6 (+27.0)"]
    assert conditioned[1] == "ours\nlate\nlaptop preset"
    assert conditioned[2].startswith("75.0 (+50.0)\n[")


def test_runs_whose_demonstrations_see_all_cameras_are_no_line_of_table_one(runs):
    make_run(runs / "all", rate=0.5, conditioning="late", n=30, m=0)
    arms = arms_of(runs)
    assert len(arms) == 3
    table = table_one(arms)
    assert sum("ours" in row[1] for row in table.rows) == 2
    assert not any(row[2].startswith("50.0") for row in table.rows)
    (arm,) = [arm for arm in arms if arm.settings["m"] == 0]
    assert paper_value(arm) is None


def test_gains_are_paired(runs):
    none, late = sorted(arms_of(runs), key=lambda a: a.settings["conditioning"] != "none")
    (row,) = gains_table([late, none]).rows
    delta = paired_difference(late.rows, none.rows)
    assert row[:6] == ["ACT", "Lift", "late", "laptop preset", "its twin", "+27.0"]
    assert row[6].startswith(f"{100 * delta.value:+.1f} [")
    assert row[7:] == [f"= {delta.p_value:.3f}", "8", "8, 8"]


def test_arms_are_compared_only_where_nothing_else_differs(tmp_path):
    make_run(tmp_path / "a", conditioning="none", model=("twin_of=late",))
    make_run(tmp_path / "b", conditioning="late", steps=1000)
    arms = arms_of(tmp_path)
    assert len(arms) == 2
    assert gains_table(arms) is None
    assert {arm.label() for arm in arms} == {
        "laptop preset, twin of late", "laptop preset, steps 1000"
    }  # fmt: skip
    assert all("+" not in row[2] for row in table_one(arms).rows if "ours" in row[1])


def test_each_arm_is_compared_with_its_own_twin_alone(tmp_path):
    """Early fusion has a stem of its own, which its twin has, too."""
    weights = {"weights": "w/resnet18.pth"}
    early, late = ("twin_of=early",), ("twin_of=late",)
    make_run(tmp_path / "a", rate=0.5, conditioning="none", model=early, stem="new", **weights)
    make_run(tmp_path / "b", rate=1.0, conditioning="early", stem="new", **weights)
    make_run(tmp_path / "c", rate=0.25, conditioning="none", model=late, **weights)
    make_run(tmp_path / "d", rate=0.5, conditioning="late", **weights)
    make_run(tmp_path / "e", rate=0.0, conditioning="none", model=early, **weights)
    make_run(tmp_path / "f", rate=0.75, conditioning="keypoints", **weights)
    make_run(tmp_path / "g", rate=0.625, conditioning="none", **weights)  # the preset's twin
    arms = arms_of(tmp_path)
    gains = {row[2]: row[6].split(" ")[0] for row in gains_table(arms).rows}
    assert gains == {"early": "+50.0", "late": "+25.0", "keypoints": "+12.5"}
    labels = [" ".join(row[1].split()) for row in table_one(arms).rows]
    named = [label for label in labels if "twin of" in label]
    assert [re.findall("twin of ([a-z]+)", line) for line in named] == [["late"], ["keypoints"]]


def test_what_stands_beside_other_networks_alone_is_told_how_to_get_its_twin(tmp_path):
    make_run(tmp_path / "a", conditioning="none")
    make_run(tmp_path / "b", conditioning="late")
    make_run(tmp_path / "c", conditioning="keypoints")
    arms = arms_of(tmp_path)
    (sentence,) = without_twins(arms)
    assert sentence.startswith("No gain is shown of ACT, late, in 1 setting: ")
    assert "(twin of keypoints)" in sentence
    assert [row[2] for row in gains_table(arms).rows] == ["keypoints"]


def test_somebody_elses_policy_stands_in_the_tables_paired(runs):
    theirs = [foreign("Pi", 0.25, "none"), foreign("Pi", 0.5), foreign("Pi", pairs=4, views=2)]
    arms = [*arms_of(runs), *group(theirs)]
    rows = [row[:2] for row in table_one(arms).rows if row[1].startswith("foreign")]
    assert rows == [
        ["Pi", "foreign\nsettings of its own"],
        ["Pi\nw. conditioning", "foreign\ngiven\nsettings of its own"],
        ["", "foreign\ngiven\nsettings of its own"],
    ]
    gains = [row for row in gains_table(arms).rows if row[0] == "Pi"]
    assert [(row[2], row[4], row[6][:5]) for row in gains] == [
        ("given", "image only, not known to be its twin", "+25.0")
    ]
    beside = [(row[2], row[6], row[7][:5]) for row in foreign_table(arms).rows]
    assert beside == [
        ("none", "ACT, late, laptop preset", "-50.0"),
        ("", "ACT, none, laptop preset, twin of late", "+0.0 "),
        ("given", "ACT, late, laptop preset", "-25.0"),
        ("", "ACT, none, laptop preset, twin of late", "+25.0"),
        ("given", "–", "–"),  # with another number of cameras its pairs are others
    ]
    assert foreign_table(arms_of(runs)) is None
    assert runs_table(theirs[:1], {}).rows[0][1] == "–"


def test_somebody_elses_policy_under_other_conditions_is_not_set_against_ours(runs):
    """It saw other pictures, or was told other poses, than ours on the same pairs."""
    wrong = foreign("Pi", 0.25, eval_pose_noise="1,1")
    arms = [*arms_of(runs), *group([wrong])]
    (row,) = foreign_table(arms).rows
    assert "eval_pose_noise 1,1" in row[3]
    assert row[6:8] == ["–", "–"]
    assert not [r for r in table_one(arms).rows if r[1].startswith("foreign")]
