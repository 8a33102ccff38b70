"""Rows of action errors: their mean, its interval, and what is no such row."""

import json

import numpy as np
import pytest

from jaxcam.errors import DatasetError
from jaxcam.results.actions import OF_MEAN, ActionErrors

ERRORS = np.array([[[1.0, 4], [3, np.nan]], [[2, 8], [4, 2]]])
ROW = ActionErrors(5, "new cameras", 0.0, 0.0, ("x", "gripper"), np.array([1.0, 2]), ERRORS)


def test_mean_over_episodes():
    value, low, high = ROW.mean()
    assert value == pytest.approx(((1 + 2 + 3) / 3 + (2 + 4 + 4 + 1) / 4) / 2)
    half = 12.7062 * 0.375  # of two episodes, at 2 and 2.75
    assert (low, high) == (0, pytest.approx(2.375 + half, rel=1e-4))


@pytest.mark.parametrize("episodes", [3, 5, 10, 30])
def test_the_interval_covers_the_mean_of_new_episodes(episodes):
    rng = np.random.default_rng(episodes)
    covered = 0
    for _ in range(1000):
        errors = rng.gamma(9, 0.1, (episodes, 1, 1))
        row = ActionErrors(0, "a", 0.0, 0.0, ("x",), np.ones(1), errors)
        _, low, high = row.mean()
        covered += low <= 0.9 <= high
    assert covered >= 930


def test_one_episode_has_no_interval():
    one = ActionErrors(5, "a", 0.0, 0.0, ("x", "y"), np.ones(2), ERRORS[1:])
    assert one.mean()[0] == pytest.approx(4)
    assert np.isnan(one.mean()[1:]).all()


def test_what_stands_still_is_not_blown_up():
    still = ActionErrors(5, "a", 0.0, 0.0, ("x",), np.zeros(1), np.full((1, 1, 1), 1e-5))
    assert still.mean()[0] == pytest.approx(0.1)


def test_json_and_back():
    back = ActionErrors.from_json(json.loads(json.dumps(ROW.to_json())))
    np.testing.assert_array_equal(back.errors, ERRORS)
    assert back.to_json() == ROW.to_json()


@pytest.mark.parametrize(
    "change",
    [{"step": 1.5}, {"step": None}, {"errors": []}, {"errors": 1}, {"errors": [[[1]]]},
     {"errors": [[[1, 2], [3]]]}, {"scale": [1]}, {"scale": [1, None]}, {"names": 3},
     {"names": ["x"]}, {"rotation_deg": "much"}, {"translation": float("inf")}, {"more": 1}],
)  # fmt: skip
def test_what_is_no_row(change):
    with pytest.raises(DatasetError, match="no row of action errors"):
        ActionErrors.from_json({**ROW.to_json(), **change})
    with pytest.raises(DatasetError, match="no row of action errors"):
        ActionErrors.from_json({})


def test_always_the_mean_has_the_error_that_is_said():
    actions = np.random.default_rng(0).normal(3, 2, 200_000)
    assert np.abs(actions - actions.mean()).mean() / actions.std() == pytest.approx(
        OF_MEAN, abs=0.01
    )
