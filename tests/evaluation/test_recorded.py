"""Errors of actions on recorded episodes: what they measure, and what moves them."""

from dataclasses import replace

import numpy as np
import pytest
import robots
from policy_inputs import start

from jaxcam.config.train import TrainConfig
from jaxcam.data.recorded.parts import HeldOut, Meaning, make_recorded, parts_of
from jaxcam.data.recorded.pictures import load_recorded_pictures
from jaxcam.evaluation.recorded import action_errors
from jaxcam.models import Policy, PolicySpec, make_policy, policy_settings
from jaxcam.runs.identity import resolve

SIZE = (24, 32)


@pytest.fixture
def learned_from(tmp_path):
    recording = robots.recording(tmp_path)
    parts = parts_of(recording, HeldOut(episodes=(1, 2)), 2)
    pictures = load_recorded_pictures(recording, parts, SIZE, tmp_path)
    return recording, parts, make_recorded(recording, parts, pictures, Meaning())


def spec(chunk, obs_steps=1):
    return PolicySpec(5, 5, 2, *SIZE, chunk=chunk, obs_steps=obs_steps)


def says_half(params, obs, key):
    """A policy that says 0.5: its errors are the distances of the actions from that."""
    return np.full((len(obs["proprio"]), 3, 5), 0.5)


HALF = Policy(lambda key: {}, lambda *_: None, says_half, None, spec(3), 3)


def test_errors_by_hand(learned_from):
    recording, parts, data = learned_from
    rows = action_errors(HALF, {}, data, parts, recording.action_names, 7)
    assert [(r.step, r.group, r.rotation_deg) for r in rows] == [
        (7, "new episodes", 0.0), (7, "new episodes", 5.0),
    ]  # fmt: skip
    for number, of_episode in enumerate((1, 2)):
        action = recording.episodes[of_episode].action
        t = np.linspace(0, len(action) - 1, 16).astype(int)
        for ahead in range(3):
            reached = t + ahead
            expected = np.abs(action[reached[reached < len(action)]] - 0.5).mean(0)
            np.testing.assert_allclose(rows[0].errors[number, ahead], expected, rtol=1e-5)
    training = np.concatenate([recording.episodes[i].action for i in (0, 3)])
    np.testing.assert_allclose(rows[0].scale, training.std(0), rtol=1e-4)


def test_nobody_is_asked_where_the_demonstration_errs(learned_from):
    """What follows an error nobody can foresee, and of a good step alone there is a number."""
    recording, parts, data = learned_from
    errors = np.zeros(data.actions.shape[:2], bool)
    errors[3] = True
    errors[3, 3] = False
    rows = action_errors(HALF, {}, replace(data, errors=errors), parts, recording.action_names, 7)
    expected = np.abs(data.actions[3, 3] - 0.5)
    np.testing.assert_allclose(rows[0].errors[1, 0], expected, rtol=1e-5)
    assert np.isnan(rows[0].errors[1, 1:]).all()
    assert np.isfinite(rows[0].mean()[0])


@pytest.mark.parametrize(
    ("policy", "conditioning", "obs_steps"),
    [
        ("act", "keypoints", 1),
        ("act", "none", 1),
        ("diffusion", "keypoints", 1),
        ("diffusion", "keypoints", 2),
    ],
)
def test_wrong_poses_matter_only_to_who_is_told(learned_from, policy, conditioning, obs_steps):
    recording, parts, data = learned_from
    fast = ("width=16", "hidden=16")
    if policy == "diffusion":
        fast = ("sample_steps=1", f"obs_steps={obs_steps}")
    model = ("encoder_width=8", "keypoints=4", "keyframe_weight=0", *fast)
    config = TrainConfig(policy=policy, conditioning=conditioning, preset="laptop", model=model)
    network = policy_settings(resolve(config, accelerator=False), ("",))
    made = make_policy(network, spec(network.chunk, network.obs_steps), data.stats())
    params = start(made)
    right, wrong = action_errors(made, params, data, parts, recording.action_names, 0)
    same = np.array_equal(right.errors, wrong.errors, equal_nan=True)
    assert same == (conditioning == "none")
    assert right.errors.shape[1] == network.chunk - obs_steps + 1
