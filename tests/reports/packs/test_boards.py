"""What stands on a leaderboard: lines in order, names that tell them apart, paired differences."""

import json
from dataclasses import replace

import pytest
from packs import foreign, ours, pack_of

from jaxcam.errors import ConfigError
from jaxcam.reports.arms import group
from jaxcam.reports.packs import boards
from jaxcam.reports.packs.boards import boards_of, over_tasks, pack_names, pose_words


@pytest.fixture
def packs(tmp_path):
    return [
        pack_of(tmp_path / "a", ours(tmp_path / "runs")),
        pack_of(tmp_path / "b", [foreign("Pi", 0.5), foreign("Pi", 1.0, "none", task="push")]),
    ]


def test_lines_stand_by_task_the_best_first(packs):
    lift, push = boards_of(packs, "test")
    assert (lift.title, push.title) == ("Lift, randomized scene", "Push, randomized scene")
    shown = [(line.policy, line.pose, line.pack, line.estimate.value) for line in lift.lines]
    assert shown == [
        ("ACT", "told the camera (late)", "a", 0.75),
        ("Pi", "told the camera", "b", 0.5),
        ("ACT", "image only", "a", 0.25),
    ]
    assert [line.rollouts for line in lift.lines] == ["8 of 1500", "8 of 50", "8 of 1500"]
    assert [line.policy for line in push.lines] == ["Pi"]


def test_differences_are_paired_and_those_of_the_reference_mirrored(packs):
    lines = boards_of(packs, "test")[0].lines
    (late,) = [a for a in group(packs[0].runs) if a.settings["conditioning"] == "late"]
    (none,) = [a for a in group(packs[0].runs) if a.settings["conditioning"] == "none"]
    d = late.against(none)
    there, back = lines[0].against[2], lines[2].against[0]
    assert there.points == f"+50.0 [{100 * d.low:+.1f}, {100 * d.high:+.1f}]"
    assert back.points == f"-50.0 [{-100 * d.high:+.1f}, {-100 * d.low:+.1f}]"
    assert there.basis == back.basis == f"p = {d.p_value:.3f}, 8 pairs"
    assert (there.value, back.value, lines[1].against[1].points) == (50.0, -50.0, "reference")
    assert json.loads(lines[2].differences())[0] == [back.points, back.basis, -50.0, back.verdict]


def test_an_interval_without_zero_is_a_verdict(tmp_path):
    packs = [pack_of(tmp_path / "a", [foreign("A", 1.0, pairs=50), foreign("B", 0.0, pairs=50)])]
    best, worst = boards_of(packs, "test")[0].lines
    assert (best.against[1].verdict, worst.against[0].verdict) == ("more", "less")


def test_lines_without_shared_pairs_or_rollouts_are_shown_without_a_difference(tmp_path):
    odd, even = foreign("A"), foreign("B")
    odd = replace(odd, rows=odd.rows[1::2])
    even = replace(even, rows=even.rows[::2])
    failed = foreign("C")
    failed = replace(
        failed, rows=[replace(r, status="simulator", success=None) for r in failed.rows]
    )
    (board,) = boards_of([pack_of(tmp_path / "a", [failed, odd, even])], "test")
    assert [line.policy for line in board.lines][2] == "C"
    assert board.lines[0].against[1].basis == "no shared pairs"
    assert board.lines[2].against[0].value is None
    json.loads(board.lines[2].differences(), parse_constant=pytest.fail)


def test_other_numbers_of_cameras_are_another_board(tmp_path):
    packs = [pack_of(tmp_path / "a", [foreign("A"), foreign("A", views=2)])]
    titles = [board.title for board in boards_of(packs, "test")]
    assert titles == ["Lift, randomized scene", "Lift, randomized scene, 2 cameras"]


def test_other_conditions_of_an_evaluation_are_another_board(tmp_path):
    """Success with wrong poses, or through other lenses, is no rank among those without."""
    wrong = foreign("A", 0.25, eval_pose_noise="1,1", eval_lens="opencv:-0.3:0")
    boards = boards_of([pack_of(tmp_path / "a", [foreign("A"), foreign("B", 1.0), wrong])], "test")
    assert [board.title for board in boards] == [
        "Lift, randomized scene",
        "Lift, randomized scene, pose_noise 1,1, lens opencv:-0.3:0",
    ]
    assert [[line.policy for line in board.lines] for board in boards] == [["B", "A"], ["A"]]
    assert {line.details for board in boards for line in board.lines} == {"settings of its own"}
    (row,) = over_tasks(boards)
    assert [line and line.estimate.value for line in row.lines] == [0.5, 0.25]


def test_policies_on_several_boards_stand_side_by_side(tmp_path):
    theirs = [foreign("Pi"), foreign("Pi", task="push", engine="sapien", rate=1.0)]
    theirs += [foreign("A"), foreign("A", task="push", note="another")]
    theirs += [foreign("B"), foreign("B", task="push"), foreign("B", task="push", engine="x")]
    boards = boards_of([pack_of(tmp_path / "a", theirs)], "test")
    (row,) = over_tasks(boards)  # A has other settings on the other task, and B has two of them
    assert row.entry == ("Pi", "told the camera", "settings of its own", "a")
    assert [line.estimate.value for line in row.lines] == [0.5, 1.0]


def test_letters_that_turn_a_line_round_are_written_out(tmp_path):
    pack = pack_of(tmp_path / "a", [foreign("A\u202eTCA", way="\u200b", note="\u2066")])
    (line,) = boards_of([pack], "test")[0].lines
    assert line.name.isprintable()
    assert line.policy == r"A\u202eTCA"


def test_packs_of_one_name_are_told_apart_by_their_digests(tmp_path):
    packs = [pack_of(tmp_path / str(i), [foreign(rate=i / 8)], "same") for i in range(2)]
    packs.append(pack_of(tmp_path / "c", [foreign()], "other"))
    digests = [pack.manifest.digest[:8] for pack in packs]
    assert pack_names(packs) == [f"same [{digests[0]}]", f"same [{digests[1]}]", "other"]
    assert len(boards_of(packs, "test")[0].lines) == 3


def test_packs_of_other_pairs_are_left_out(packs):
    with pytest.raises(ConfigError, match="None of the packs has rollouts of validation pairs"):
        boards_of(packs, "validation")


def test_a_page_has_so_many_settings_at_most(packs, monkeypatch):
    monkeypatch.setattr(boards, "MOST", 2)
    with pytest.raises(
        ConfigError, match="3 settings of lift, randomized, but a page has 2 at most"
    ):
        boards_of(packs, "test")


@pytest.mark.parametrize(("way", "words"), [("none", "image only"), ("given", "told the camera")])
def test_what_a_policy_is_told_is_said_in_words(way, words):
    assert pose_words(*group([foreign(way=way)])) == words
