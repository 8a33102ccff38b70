"""Rollouts of a run as exhibits."""

import json

import numpy as np
import pytest
from made_runs import make_run
from served_runs import untrained_run

from jaxcam.config.conditions import Conditions
from jaxcam.data.pairs import make_pairs
from jaxcam.data.splits import SPLITS
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.evaluation.checkpoint import Wanted, evaluate
from jaxcam.evaluation.conditions import ConditionedPairs
from jaxcam.evaluation.evaluator import Candidate, Evaluator
from jaxcam.rays import invert
from jaxcam.runs.identity import read_config
from jaxcam.training.checkpoint import load_policy_inputs, rebuild_policy
from jaxcam.viewer import simulated
from jaxcam.viewer.exhibit import RED
from jaxcam.viewer.rollouts import Rolled

PAIRS = 2


@pytest.fixture(autouse=True)
def few_small_pictures(monkeypatch):
    monkeypatch.setattr(simulated, "SIDE", 24)
    monkeypatch.setattr(simulated, "DRAWN", 4)


@pytest.fixture
def made(tmp_path):
    """A run whose checkpoint is gone: of eight pairs the first four succeed."""
    return make_run(tmp_path / "run", rate=0.5, data_dir=str(tmp_path))


def without_pairs(folder):
    """Its rows without the made-up digests of pairs."""
    file = folder / "eval" / "rows.jsonl"
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    for row in rows:
        row.pop("pair_sha")
    file.write_text("".join(json.dumps(row) + "\n" for row in rows))
    return folder


def test_without_a_checkpoint_the_start_is_shown_under_the_sphere(made, lift, scene):
    rolled = Rolled.open(without_pairs(made), "test", None)
    assert rolled.pairs()[0] == "success in 70 steps"
    assert rolled.pairs()[7] == "failure"
    exhibit = rolled.exhibit(5)
    assert exhibit.length == 1
    assert any("start only" in note for note in exhibit.notes)
    (outcomes,) = exhibit.outcomes
    assert outcomes.numbers == tuple(range(8))
    np.testing.assert_array_equal(outcomes.rates, [1] * 4 + [0] * 4)
    pairs = make_pairs(lift, scene, rolled.config.views, "test", range(8))
    base_from_world = np.asarray(invert(scene.world_from_base))
    places = (base_from_world @ pairs.cameras[:, 0])[:, :3, 3]
    np.testing.assert_allclose(outcomes.places, places, atol=1e-6)
    assert {v.colour for v in exhibit.viewpoints if v.group == "test"} == {RED}
    # All balls are near the sphere, which is of their mean distance.
    centre = base_from_world[:3, :3] @ np.array(lift.cameras.centre) + base_from_world[:3, 3]
    radius = np.linalg.norm(outcomes.shell - centre, axis=-1)
    np.testing.assert_allclose(radius, np.linalg.norm(places - centre, axis=-1).mean(), atol=1e-6)
    assert outcomes.smooth.min() >= 0
    assert outcomes.smooth.max() <= 1


def test_a_run_without_rollouts_is_told_how_to_get_some(made):
    with pytest.raises(DatasetError, match=r"jaxcam\.evaluate"):
        Rolled.open(made, "validation", None)
    with pytest.raises(DatasetError, match="at step 7"):
        Rolled.open(without_pairs(made), "test", 7)


def test_a_run_on_recorded_episodes_has_none(made, monkeypatch):
    config = json.loads((made / "config.json").read_text())
    monkeypatch.setattr("jaxcam.viewer.rollouts.RECORDED", config["task"])
    with pytest.raises(ConfigError, match="recorded episodes"):
        Rolled.open(made, "test", None)


def test_a_rollout_is_made_anew_and_ends_as_its_row_says(tmp_path):
    """Of a policy that was never trained; its row is of a whole evaluation."""
    folder = untrained_run(tmp_path / "run", data_dir=str(tmp_path))
    inputs = load_policy_inputs(folder)
    evaluator = Evaluator(inputs.config, width=PAIRS)
    candidate = Candidate(rebuild_policy(inputs), inputs.params, folder, inputs.step)
    evaluate(evaluator, candidate, Wanted("test", PAIRS, videos=0), None)
    rolled = Rolled.open(folder, "test", None)
    exhibit = rolled.exhibit(1)
    assert "The rollout was made anew, and ends as its row says." in exhibit.notes
    (row,) = [row for row in rolled.rows if row.pair == 1]
    assert exhibit.length == row.steps + 1
    assert row.episode_seed == SPLITS["test"].episodes + 1
    assert read_config(folder).task in exhibit.title


def test_cameras_have_the_intrinsics_and_lenses_of_the_run_s_conditions(made, lift, scene):
    """A run whose cameras differ is evaluated with such as it was trained with."""
    config = json.loads((made / "config.json").read_text())
    optics = {"fovy": "20:70", "lens": "opencv:-0.3:-0.1"}
    (made / "config.json").write_text(json.dumps(config | optics))
    file = without_pairs(made) / "eval" / "rows.jsonl"
    said = {f"eval_{name}": text for name, text in optics.items()}
    rows = [json.loads(line) | said for line in file.read_text().splitlines()]
    file.write_text("".join(json.dumps(row) + "\n" for row in rows))
    rolled = Rolled.open(made, "test", None)
    exhibit, numbers = rolled.exhibit(5), list(rolled.pairs())
    pairs = make_pairs(lift, scene, rolled.config.views, "test", numbers)
    conditioned = ConditionedPairs(lift, scene, Conditions(**optics))
    optics_of = conditioned.seen(pairs, "test", numbers, (24, 24))
    cameras = [v.camera for v in exhibit.viewpoints if v.group == "test"]
    expected = [5, *(number for number in numbers if number != 5)]
    np.testing.assert_allclose([c.K for c in cameras], optics_of.K[expected, 0])
    np.testing.assert_array_equal([c.distortion for c in cameras], optics_of.lens[expected, 0])
    assert exhibit.viewpoints[0].pictures
