"""Rows of action errors: their mean, its interval, and what is no such row."""

import json

import numpy as np
import pytest

from jaxcam.errors import DatasetError
from jaxcam.results.actions import ActionErrors

ERRORS = np.array([[[1.0, 4], [3, np.nan]], [[2, 8], [4, 2]]])
ROW = ActionErrors(5, "new cameras", 0.0, 0.0, ("x", "gripper"), np.array([1.0, 2]), ERRORS)


def test_mean_over_episodes():
    value, low, high = ROW.mean()
    assert value == pytest.approx(((1 + 2 + 3) / 3 + (2 + 4 + 4 + 1) / 4) / 2)
    assert low == pytest.approx(2)
    assert high == pytest.approx(2.75)


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
