"""Numbers of a recorded dataset that make no sense are found, and the episode is named."""

import re
from dataclasses import replace

import numpy as np
import pytest
from filmed import with_state
from robots import recording as robot

from jaxcam.checks.recorded.numbers import check_numbers, statistics_of_recording
from jaxcam.data.recorded.parts import meaning_of


def numbers(data):
    return list(check_numbers(data, meaning_of(data)))


def marks(data):
    return {j.finding.what: j.finding.mark for j in numbers(data)}


def with_episode(data, number, **changes):
    episodes = list(data.episodes)
    episodes[number] = replace(episodes[number], **changes)
    return replace(data, episodes=episodes)


def smooth(data):
    """The dataset with a column of the state that goes steadily, as a joint does."""
    for i, episode in enumerate(data.episodes):
        state = episode.state.copy()
        state[:, 3] = 0.1 * np.arange(episode.length)
        data = with_episode(data, i, state=state)
    return data


@pytest.fixture
def data(tmp_path):
    return smooth(robot(tmp_path, episodes=5))


def test_nothing_is_wrong_with_good_numbers(data):
    assert set(marks(data).values()) == {"good"}


def repeat(data):
    first = data.episodes[0]
    return with_episode(data, 3, state=first.state, action=first.action)


def wrapped(data):
    state = data.episodes[2].state.copy()
    state[:, 3] += np.pi - 0.3
    state[3:, 3] -= 2 * np.pi
    return with_episode(data, 2, state=state)


def flickering(data):
    action = data.episodes[1].action.copy()
    action[:, 2] = np.where(np.arange(len(action)) % 3, np.pi, -np.pi)
    for i, episode in enumerate(data.episodes):
        still = np.array(episode.action)
        still[:, 2] = 3.1
        data = with_episode(data, i, action=action if i == 1 else still)
    return data


def fast(data):
    return replace(data, rate=200.0)


def still(data):
    for i, episode in enumerate(data.episodes):
        data = with_episode(data, i, action=episode.action * [1, 0, 1, 1, 1])
    return data


def short(data):
    episode = data.episodes[1]
    return with_episode(data, 1, state=episode.state[:2], action=episode.action[:2])


def narrow(data):
    return with_episode(data, 4, state=data.episodes[4].state[:-1])


CASES = {
    "NaN": (lambda d: with_state(d, 2, 4, 0, np.nan), "numbers", "bad", (2,), "from step 4 on"),
    "a copy": (repeat, "duplicates", "bad", (3,), "1 are copies"),
    "a turn": (wrapped, "jumps", "note", (2,), r"full turn.*state wrist"),
    "turns": (flickering, "jumps", "note", (1,), r"full turn.*action joint_2"),
    "a leap": (lambda d: with_state(d, 1, 5, 3, 3.0), "jumps", "note", (1,), "state wrist"),
    "far away": (lambda d: with_state(d, 3, 2, 1, 90.0), "outliers", "note", (3,), "state ee_y"),
    "too fast": (fast, "rate", "note", (0, 1, 2, 3, 4), "the grip moves at up to"),
    "no rate": (lambda d: replace(d, rate=0.01), "rate", "bad", (), "0.01 steps"),
    "constant": (still, "constant numbers", "note", (), "action joint_1"),
    "short": (short, "lengths", "note", (1,), "2 to 14 steps"),
    "shapes": (narrow, "shapes", "bad", (4,), "other shapes"),
}


@pytest.mark.parametrize("case", CASES)
def test_what_is_odd_is_found_and_its_episode_named(data, case):
    spoil, what, mark, episodes, words = CASES[case]
    odd = [j for j in numbers(spoil(data)) if (j.finding.what, j.finding.mark) == (what, mark)]
    (one,) = [j for j in odd if j.episodes == episodes]
    text = f"{one.finding.got} {one.finding.where}"
    assert re.search(words, text)
    if episodes and len(episodes) < len(data.episodes):
        assert data.episodes[episodes[0]].name in one.finding.where


def test_noise_and_switches_do_not_jump(data):
    state = data.episodes[0].state.copy()
    state[:, 4] = np.arange(len(state)) % 2  # a gripper that opens and closes
    assert marks(with_episode(data, 0, state=state))["jumps"] == "good"


def test_statistics_have_a_row_for_each_number(data):
    rows = statistics_of_recording(data)
    assert [row[0] for row in rows[:3]] == ["steps", "state, ee_x", "state, ee_y"]
    assert len(rows) == 1 + len(data.state_names) + len(data.action_names)
    assert rows[0][1:] == ("10", "12", "14")


def test_errors_on_purpose_are_counted_where_somebody_says_so(data):
    assert "errors on purpose" not in marks(data)
    err = np.arange(data.episodes[0].length) < 3
    (finding,) = (
        j.finding
        for j in numbers(with_episode(data, 0, errors=err))
        if j.finding.what == "errors on purpose"
    )
    assert finding.mark == "good"
    assert finding.got == "5.0% of the actions, in 1 demonstrations: not taught"
