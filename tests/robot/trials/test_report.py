"""The report: rates, differences, bars, and who was who."""

import numpy as np
import pytest
from web_page import Page

from jaxcam.errors import ConfigError
from jaxcam.robot.trials.order import letters, rollouts
from jaxcam.robot.trials.report import Trial, write_trials
from jaxcam.robot.trials.rows import TrialRow
from jaxcam.robot.trials.sheet import CamerasEntry, PolicyEntry, Sheet


def made_up(folder, task="Pick Place", names=("With poses", "Without"), chances=((7, 2), (3, 3))):
    """A trial of the paper's size, whose outcomes are drawn: parts of 10 whole, and half."""
    cameras = CamerasEntry(("left", "right", "top"), 2, "cameras.json", tuple("1234567"))
    entries = tuple(PolicyEntry(name, f"ws://127.0.0.1:{i}") for i, name in enumerate(names))
    sheet = Sheet(task, "It is in.", "It slipped.", entries, ("On 1.", "On 2."), cameras)
    planned, rng, rows = rollouts(sheet), np.random.default_rng(0), []
    for rollout in planned:
        whole, half = chances[rollout.policy]
        outcome = rng.choice(
            ["success", "half", "failure"], p=[whole / 10, half / 10, 1 - (whole + half) / 10]
        )
        condition = rollout.condition
        rows.append(TrialRow(
            number=rollout.number, policy=rollout.letter, placement=condition.placement,
            cameras=condition.cameras, start=condition.start, outcome=str(outcome), seconds=12.3,
            comment="<b>bold</b>" if rollout.number == 1 else "",
        ))  # fmt: skip
    return Trial(sheet, folder, planned, rows)


def test_twenty_one_rollouts_a_setting(tmp_path):
    trial = made_up(tmp_path)
    page = Page(write_trials([trial], tmp_path))
    counts = {
        policy: [
            row.outcome for row in trial.rows if trial.planned[row.number - 1].policy == policy
        ]
        for policy in (0, 1)
    }
    rates = [100 * counts[policy].count("success") / 21 for policy in (0, 1)]
    for policy, (name, letter) in enumerate(
        zip(("With poses", "Without"), letters(trial.sheet), strict=True)
    ):
        assert f"{name} {letter} 21 {rates[policy]:.0f} % [" in " ".join(page.text.split())
    assert f"{rates[0] - rates[1]:+.0f} [" in page.text
    assert "<b>bold</b>" in page.text  # escaped
    assert "missing" not in page.text
    assert (tmp_path / "figures" / "outcomes.png").stat().st_size > 10_000


def test_what_is_missing_is_told_and_compared_on_what_all_have_met(tmp_path):
    trial = made_up(tmp_path)
    part = Trial(trial.sheet, tmp_path, trial.planned, trial.rows[:7])
    text = " ".join(Page(write_trials([part], tmp_path)).text.split())
    assert "35 of 42 rollouts are missing" in text
    assert "conditions With poses − Without success" in text
    assert " 3 With poses − Without at least half" in text  # the seventh has no partner yet


def test_several_tasks_stand_side_by_side(tmp_path):
    trials = [made_up(tmp_path, task) for task in ("Pick Place", "Hang Mug")]
    assert "Pick Place, Hang Mug" in Page(write_trials(trials, tmp_path)).text


def test_a_page_of_somebody_else_s_is_left_alone(tmp_path):
    (tmp_path / "report.html").write_text("mine")
    with pytest.raises(ConfigError, match="jaxcam did not write it"):
        write_trials([made_up(tmp_path)], tmp_path)
    assert (tmp_path / "report.html").read_text() == "mine"
