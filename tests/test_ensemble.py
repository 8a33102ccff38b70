"""Temporal ensembling against its definition, the golden weights and LeRobot's."""

import json
from pathlib import Path

import numpy as np
import pytest

from jaxcam.ensemble import ensemble, weights

GOLDEN = Path(__file__).parent / "golden"


def run(chunks, rate):
    before, actions = None, []
    for chunk in chunks:
        action, before = ensemble(before, chunk, rate)
        actions.append(action)
    return np.stack(actions)


def test_golden_weights():
    expected = json.loads((GOLDEN / "schedules.json").read_text())["act_temporal_agg_n100_k0.01"]
    got = weights(100, 0.01)
    assert got.sum() == pytest.approx(1)
    assert [got[0], got[1], got[-1]] == pytest.approx(list(expected.values()))


@pytest.mark.parametrize("rate", [0.0, 0.01, 0.5])
def test_an_action_is_the_mean_of_all_that_was_predicted_for_it(rate):
    chunks = np.random.default_rng(0).normal(size=(9, 2, 4, 3))
    actions = run(chunks, rate)
    for t, action in enumerate(actions):
        first = max(0, t - 3)
        said = np.stack([chunks[s][:, t - s] for s in range(first, t + 1)])
        expected = np.tensordot(weights(len(said), rate), said, 1)
        np.testing.assert_allclose(action, expected, rtol=1e-12)


def test_actions_equal_lerobots():
    golden = np.load(GOLDEN / "act_public.npz")
    actions = run(golden["ensemble/chunks"], 0.01)
    np.testing.assert_allclose(actions, golden["ensemble/actions"], rtol=1e-5, atol=1e-6)
