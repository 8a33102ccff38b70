"""What the operator is asked and told, and that nothing rated is ever lost."""

import dataclasses
import io
import json

import pytest
from rehearsal import small_cameras
from rich.console import Console

from jaxcam.errors import ConfigError
from jaxcam.interrupts import Stopped
from jaxcam.robot.trials.attempts import Ran
from jaxcam.robot.trials.keyboard import QuitError
from jaxcam.robot.trials.order import rollouts
from jaxcam.robot.trials.policies import Served
from jaxcam.robot.trials.rows import read_trial_rows
from jaxcam.robot.trials.session import TrialSession, check_weights
from jaxcam.robot.trials.sheet import CamerasEntry, PolicyEntry, Sheet

SHEET = Sheet(
    "Lift", "It is lifted.", "It was raised.",
    (PolicyEntry("x", "ws://x"), PolicyEntry("y", "ws://y")), ("Cup on 1.", "Cup on 2."),
)  # fmt: skip
PLANNED = rollouts(SHEET)


class Typist:
    """Answers that are lines, or errors to raise."""

    def __init__(self, answers):
        self._answers = iter(answers)

    def ask(self, question):
        answer = next(self._answers, QuitError())
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def pressed(self):
        return False


class Fake:
    """Runs nothing."""

    def __init__(self, ran=None):
        self._ran = ran or Ran(1.5, lateness="5 actions")

    def run(self, attempt, is_over):
        if isinstance(self._ran, BaseException):
            raise self._ran
        return self._ran


def session(folder, answers, ran=None, shas=("", ""), sheet=SHEET):
    planned = rollouts(sheet)
    file = folder / "rows.jsonl"
    served = [
        Served(entry, None, {"weights_sha": sha})
        for entry, sha in zip(SHEET.policies, shas, strict=True)
    ]
    console = Console(file=io.StringIO(), width=200)
    return TrialSession(
        sheet, folder, file, planned, served, Fake(ran), Typist(answers), console,
        read_trial_rows(file, planned),
    )  # fmt: skip


def outcomes(folder):
    return [(row.number, row.outcome) for row in read_trial_rows(folder / "rows.jsonl", PLANNED)]


def test_ratings_with_comments_and_what_is_none(tmp_path):
    some = session(tmp_path, ["", "half cup tipped", "", "x", "S", "", "f"])
    assert not some.go()
    assert outcomes(tmp_path) == [(1, "half"), (2, "success"), (3, "failure")]
    first = read_trial_rows(tmp_path / "rows.jsonl", PLANNED)[0]
    assert (first.comment, first.seconds, first.lateness) == ("cup tipped", 1.5, "5 actions")
    printed = some.console.file.getvalue()
    assert "Success: It is lifted.\n  Half: It was raised." in printed
    assert "'x' is none of s, h, f, r and q." in printed
    assert "Start 1: Cup on 1." in printed


def test_nothing_but_enter_begins(tmp_path):
    some = session(tmp_path, ["s", "begin", "", "f"])  # a rating that was typed twice, say
    assert not some.go()
    assert outcomes(tmp_path) == [(1, "failure")]
    assert "'s' is neither Enter, b nor q." in some.console.file.getvalue()


def test_it_goes_on_where_it_stopped_until_all_is_done(tmp_path):
    assert not session(tmp_path, ["", "s"]).go()
    assert session(tmp_path, ["", "s"] * 3).go()
    assert [number for number, _ in outcomes(tmp_path)] == [1, 2, 3, 4]


def test_one_that_was_rated_by_mistake_is_run_again(tmp_path):
    session(tmp_path, ["b", "", "s", "back", "", "h"]).go()
    assert outcomes(tmp_path) == [(1, "success"), (1, "redo"), (1, "half")]


def test_what_the_robot_says_is_only_agreed_to(tmp_path):
    session(tmp_path, ["", "", "", "f"], Ran(1.0, outcome="half")).go()
    assert outcomes(tmp_path) == [(1, "half"), (2, "failure")]


def test_enter_is_no_rating_where_nobody_proposes_one(tmp_path):
    session(tmp_path, ["", "", "h"]).go()
    assert outcomes(tmp_path) == [(1, "half")]


@pytest.mark.parametrize("error", [Stopped(130), QuitError()])
def test_stopped_before_it_was_rated(tmp_path, error):
    some = session(tmp_path, ["", "s", "", error])
    if isinstance(error, Stopped):
        with pytest.raises(Stopped):
            some.go()
    else:
        assert not some.go()
    assert outcomes(tmp_path) == [(1, "success"), (2, "redo")]


def test_stopped_while_it_ran(tmp_path):
    with pytest.raises(Stopped):
        session(tmp_path, [""], Stopped(130)).go()
    assert outcomes(tmp_path) == [(1, "redo")]


def test_what_ended_it_is_shown_and_kept(tmp_path):
    some = session(tmp_path, ["", "r"], Ran(0.5, fault="policy B refused: no picture"))
    some.go()
    assert "What ended it: policy B refused: no picture" in some.console.file.getvalue()
    assert (
        read_trial_rows(tmp_path / "rows.jsonl", PLANNED)[0].fault == "policy B refused: no picture"
    )


def test_a_calibration_that_changed_half_way_is_told(tmp_path):
    small_cameras(tmp_path)
    cameras = CamerasEntry(("first", "second"), 1, "cameras.json", ("1",))
    sheet = dataclasses.replace(SHEET, cameras=cameras)
    printed = []
    for _ in range(2):
        some = session(tmp_path, ["", "s"], sheet=sheet)
        some.go()
        printed.append(some.console.file.getvalue())
        file = tmp_path / "cameras.json"
        content = json.loads(file.read_text())
        for camera in content["episodes"]["1"].values():
            camera["base_from_camera"]["position"][0] += 0.01
        file.write_text(json.dumps(content))
    assert "calibrated otherwise" not in printed[0]
    assert "was calibrated otherwise in rollout 1, in the same placement" in printed[1]


def test_other_weights_than_before_are_refused(tmp_path):
    some = session(tmp_path, ["", "s", "", "s"], shas=("a" * 20, "b" * 20))
    some.go()
    check_weights(PLANNED, some.rows, some.served)
    other = session(tmp_path, [], shas=("a" * 20, "c" * 20))
    with pytest.raises(ConfigError, match="Policy 'y': ws://y serves the weights cccccccccccc"):
        check_weights(PLANNED, other.rows, other.served)
