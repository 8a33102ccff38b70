"""Cameras that moved in some episodes."""

from dataclasses import replace

import numpy as np
import pytest
from boxed_arm import CAMERA, boxed_arm, film

from jaxcam.robot.calibration.drift.change import (
    AskedChange,
    ask,
    changes_asked,
    judged_changes,
    runs_of,
    with_common_joints,
)
from jaxcam.robot.calibration.projection import apart, moved

ARM = np.array([0.1, 0.0, 1.0])
BUMP = np.r_[0.0, 0.0, 0.0, np.deg2rad([0.8, -0.8, 0.0])]


def test_a_camera_that_was_turned_is_found_with_its_episode_and_pose():
    elsewhere = moved(CAMERA, BUMP)
    cameras = [CAMERA] * 4 + [elsewhere] * 2
    shown = film(cameras, off=(np.deg2rad(0.4), 0, 0))
    films = [shown.some(shown.episodes == e) for e in range(6)]
    answers = judged_changes(changes_asked(boxed_arm(), films, [CAMERA] * 6))
    assert [a.moved for a in answers] == [False] * 4 + [True] * 2
    (run,) = runs_of(answers)
    assert run[0].asked.episode == 4
    place, turn = apart(run[0].pose, elsewhere)
    assert place < 0.012
    assert turn < np.deg2rad(0.6)


def drawn(change, episode, rng, support=0.8, share=1.0):
    sigma = share * np.repeat([0.002, 0.001], 3)
    noise, covariance = rng.normal(0, sigma), np.diag(sigma**2)
    return AskedChange(episode, CAMERA, change + noise, covariance, support, np.zeros(3), ARM)


@pytest.mark.parametrize("support", [0.4, 0.1])
def test_an_episode_whose_contours_lie_on_wrong_edges_is_looked_for_where_most_stand(support):
    """As on drawn films: 23 cm and 11 degrees off, with two fifths of the contour on edges."""
    shown = film([CAMERA] * 4, off=(np.deg2rad(0.4), 0, 0))
    films = [shown.some(shown.episodes == e) for e in range(4)]
    first = [ask(boxed_arm(), one, CAMERA) for one in films]
    far = np.r_[0.1, -0.2, 0.0, np.deg2rad([10.0, 3.0, 0.0])]
    first[2] = replace(first[2], change=far, support=support)
    again = with_common_joints(boxed_arm(), films, first)
    others = np.mean([a.change for i, a in enumerate(again) if i != 2], 0)
    np.testing.assert_allclose(again[2].change, others, atol=0.01)
    assert [a.moved for a in judged_changes(again)] == [False] * 4


def test_what_all_episodes_ask_for_is_no_motion():
    """It is the joints' fault; and one in a thousand is called a motion at most."""
    rng = np.random.default_rng(0)
    common = np.r_[0.008, 0, 0, 0, 0.004, 0]
    alarms = [
        t.moved
        for _ in range(40)
        for t in judged_changes([drawn(common, e, rng) for e in range(25)])
    ]
    assert np.mean(alarms) <= 0.002


def test_where_no_episode_is_clear_at_the_second_look_nothing_is_said():
    shown = film([CAMERA] * 2)
    films = [shown.some(shown.episodes == e) for e in range(2)]
    away = np.r_[0.0, 0.0, -0.4, np.deg2rad([0.0, 25.0, 0.0])]
    first = [replace(ask(boxed_arm(), one, CAMERA), change=away, support=0.4) for one in films]
    again = with_common_joints(boxed_arm(), films, first)
    assert not any(a.clear for a in again)
    assert judged_changes(again) == []


def test_an_episode_with_little_of_its_contour_on_edges_must_be_further_away():
    bump = np.r_[0.03, 0, 0, 0, 0, 0.015]
    for support, moves in ((0.8, True), (0.45, False)):
        rng = np.random.default_rng(1)
        asked = [drawn(bump * (e == 4), e, rng, support=support if e == 4 else 0.8)
                 for e in range(8)]  # fmt: skip
        assert [t.moved for t in judged_changes(asked)] == [moves and e == 4 for e in range(8)]


def test_a_turn_about_the_arm_is_no_motion_and_as_large_a_one_of_the_camera_is():
    """The picture of the arm hardly changes: contours and edges differ by more than that."""
    turn, sight = np.deg2rad([0.0, 0.7, 0.0]), np.deg2rad(0.7) * ARM / np.linalg.norm(ARM)
    swing, own = np.r_[np.cross(ARM, turn), turn], np.r_[np.zeros(3), turn]
    for change, moves in ((swing, False), (own, True), (np.r_[np.zeros(3), sight], True)):
        rng = np.random.default_rng(2)
        asked = [drawn(change * (e == 4), e, rng, share=0.5) for e in range(8)]
        assert [t.moved for t in judged_changes(asked)] == [moves and e == 4 for e in range(8)]


@pytest.mark.parametrize("first", [3, 7, 12])
def test_moves_are_named_from_the_first_episode_on_and_back(first):
    rng = np.random.default_rng(first)
    bump = np.r_[0.02, 0, 0, 0, 0, 0.02]
    changes = [bump if first <= e < first + 3 else np.zeros(6) for e in range(16)]
    answers = judged_changes([drawn(c, e, rng) for e, c in enumerate(changes)])
    (run,) = runs_of(answers)
    assert [one.asked.episode for one in run] == [first, first + 1, first + 2]
    np.testing.assert_allclose(run[0].change, bump, atol=0.006)


def test_a_camera_that_creeps_is_not_given_one_pose_for_all_its_places():
    changes = [np.r_[0.003 * max(e - 9, 0), 0, 0, 0, 0, 0] for e in range(30)]
    answers = judged_changes([drawn(c, e, np.random.default_rng(e)) for e, c in enumerate(changes)])
    runs = runs_of(answers)
    by_episode = {one.asked.episode: one.change[0] for run in runs for one in run}
    assert len(runs) > 1
    assert set(by_episode) >= set(range(15, 30))
    true = np.array([changes[e][0] for e in by_episode])
    np.testing.assert_allclose(list(by_episode.values()), true, atol=0.018)


def test_episodes_that_say_nothing_are_left_out():
    rng = np.random.default_rng(0)
    asked = [drawn(np.zeros(6), e, rng, support=0.1 if e == 2 else 0.8) for e in range(5)]
    assert [t.asked.episode for t in judged_changes(asked)] == [0, 1, 3, 4]
    assert judged_changes([asked[2]]) == []


def test_an_episode_between_two_moves_that_stood_as_most_did_is_no_move():
    change = np.r_[0.03, 0, 0, 0, 0, 0]
    at = {e: 10 <= e < 30 and e not in (19, 22, 23) for e in range(40)}
    answers = judged_changes([
        drawn(change * moves, e, np.random.default_rng(e)) for e, moves in at.items()
    ])  # fmt: skip
    assert {one.asked.episode: one.moved for one in answers} == at


@pytest.mark.parametrize(("count", "right"), [(20, 4), (200, 40)])
def test_a_camera_that_was_pushed_early_is_wrong_in_most_episodes(count, right):
    """The few before it ask for nothing: so the given pose is theirs."""
    change = np.r_[0.018, 0, 0, 0, 0, 0]
    answers = judged_changes([
        drawn(change * (e >= right), e, np.random.default_rng(e), share=0.5) for e in range(count)
    ])  # fmt: skip
    assert [one.moved for one in answers] == [e >= right for e in range(count)]
