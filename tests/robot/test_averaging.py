"""Means of predicted actions."""

import numpy as np
import pytest

from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.rays.rotations import matrix_from_rotvec
from jaxcam.robot.averaging import Averaging, check_averages
from jaxcam.runs.identity import resolve


def config(**settings):
    return resolve(TrainConfig(**settings), accelerator=False)


def test_means_weigh_older_predictions_more():
    averaging = Averaging("joint_abs", 0.5)
    chunks = np.random.default_rng(0).normal(size=(3, 4, 8)).astype(np.float32)
    got = [averaging(chunk) for chunk in chunks]
    assert got[0].shape == (1, 8)
    np.testing.assert_array_equal(got[0][0], chunks[0, 0])
    weights = np.exp(-0.5 * np.arange(3))
    expected = np.average([chunks[0, 2], chunks[1, 1], chunks[2, 0]], axis=0, weights=weights)
    np.testing.assert_allclose(got[2][0], expected, atol=1e-6)
    averaging.restart()
    np.testing.assert_array_equal(averaging(chunks[1])[0], chunks[1, 0])


def test_rotations_are_averaged_as_rotations():
    """Rotation vectors on both sides of half a turn are nearly the same rotation."""
    averaging = Averaging("eef_abs", 0.01)
    chunk = np.zeros((4, 7), np.float32)
    chunk[:, 5] = np.pi - 0.1
    averaging(chunk)
    chunk[:, 5] = -np.pi + 0.1
    [action] = averaging(chunk)
    turned = matrix_from_rotvec(action[3:6].astype(float))
    np.testing.assert_allclose(turned, np.diag([-1, -1, 1]), atol=0.01)


@pytest.mark.parametrize("others", [0, 2])
def test_numbers_behind_a_grip_pose_are_averaged_one_by_one(others):
    averaging = Averaging("eef_abs", 0.0)
    chunks = np.random.default_rng(0).normal(size=(2, 3, 6 + others)).astype(np.float32)
    chunks[..., 3:6] = 0.5
    averaging(chunks[0])
    [action] = averaging(chunks[1])
    np.testing.assert_allclose(action, (chunks[0, 1] + chunks[1, 0]) / 2, atol=1e-6)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"action_space": "eef_delta"}, "eef_delta, which say how far to go"),
        ({"action_space": "joint_delta"}, "joint_delta, which say how far to go"),
        ({"task": "recorded"}, "--action-is unknown"),
        ({"task": "recorded", "action_is": "eef_abs"}, "--action-is eef_abs"),
    ],
)
def test_means_without_a_meaning_are_refused(settings, words):
    with pytest.raises(ConfigError, match=words):
        check_averages(config(**settings))


def test_spaces_of_targets_have_means():
    assert check_averages(config(action_space="eef_abs")) == "eef_abs"
    assert check_averages(config(action_space="joint_abs")) == "joint_abs"
    assert check_averages(config(task="recorded", action_is="joint_abs")) == "joint_abs"
