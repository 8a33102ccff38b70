"""Policies to LeRobot's layout of a checkpoint and back; that LeRobot agrees, a script checks."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import places
import pytest
from lerobot_policies import ACTION, PROPRIO, SIDE, inputs_of, settings_for

from jaxcam.config.commands import WeightsConfig
from jaxcam.config.train import TrainConfig
from jaxcam.errors import CheckpointError
from jaxcam.interop.lerobot.counterparts import policy_file
from jaxcam.interop.lerobot.layout import config_of, settings_of, spec_of
from jaxcam.interop.lerobot.policy import adopt, export_policy, read_foreign
from jaxcam.models import FAMILIES, PolicySpec
from jaxcam.models.conditioning import with_conditioning
from jaxcam.models.normalization import (
    action_deviation,
    action_range,
    proprio_deviation,
    proprio_range,
)
from jaxcam.models.weights.load import read_weights
from jaxcam.runs.identity import read_config
from jaxcam.training.checkpoint import load_policy_inputs

pytest.importorskip("safetensors")


def scaled(inputs):
    """What its network sees of some proprioception, and the actions that some outputs become."""
    stats, settings = inputs.stats, FAMILIES[inputs.config.policy].config(**inputs.settings)
    floors = settings.floors
    if inputs.config.policy == "act":
        action = action_deviation(stats, settings.action_std_floor, floors=floors)
        proprio = proprio_deviation(stats, floors=floors)
    else:
        action = action_range(stats, floors=floors)
        proprio = proprio_range(stats, floors=floors)
    outputs = np.linspace(-1, 1, 5, dtype=np.float32)[:, None]
    return proprio.normalised(stats["proprio_mean"] + outputs), action.raw(outputs)


CASES = [
    ("act", {}, 1),
    ("act", {"image_scaling": "symmetric", "pre_norm": True}, 2),
    ("diffusion", {"sampler": "ddim", "sample_steps": 3}, 1),
    ("diffusion", {"encoder_per_view": True, "crop": 28, "sample_steps": 2}, 2),
]


@pytest.mark.parametrize(("name", "changes", "views"), CASES)
def test_there_and_back_it_is_the_same(tmp_path, name, changes, views):
    inputs = inputs_of(settings_for(name, **changes), views, 0.02 if name == "act" else 0.0)
    export_policy(inputs, tmp_path / "out")
    task = "lift" if views == 1 else "pick_place_can"
    adopt(tmp_path / "out", TrainConfig(task=task, run_dir=str(tmp_path / "run")))
    back = load_policy_inputs(tmp_path / "run")
    jax.tree.map(np.testing.assert_array_equal, back.params, inputs.params)
    for got, expected in zip(scaled(back), scaled(inputs), strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-6, atol=2e-7)
    assert back.step == 0
    assert (back.config.policy, back.config.views, back.config.resolution) == (name, views, SIDE)
    assert back.config.ensemble == inputs.config.ensemble
    record = json.loads((tmp_path / "run/weights.json").read_text())
    assert record["sha256"] == read_weights(tmp_path / "out/model.safetensors").sha256


@pytest.mark.parametrize("name", ["act", "diffusion"])
def test_settings_there_and_back(name):
    settings: Any = settings_for(name)
    spec = PolicySpec(ACTION, PROPRIO, 2, SIDE, SIDE, settings.chunk, settings.obs_steps)
    config = config_of(settings, spec)
    theirs = policy_file(json.loads(json.dumps(config)))
    back = settings_of(theirs, "imagenet")
    assert spec_of(theirs) == spec
    floors = {"action_std_floor": back.action_std_floor} if name == "act" else {}
    assert back == replace(settings, floors=False, **floors)


def test_the_original_act_has_a_place_there_but_for_a_head_that_nobody_reads(tmp_path):
    inputs = inputs_of(settings_for("act", preset="original"))
    assert "is_pad" in inputs.params["head"]
    export_policy(inputs, tmp_path / "out")
    adopt(tmp_path / "out", TrainConfig(run_dir=str(tmp_path / "run")))
    back = load_policy_inputs(tmp_path / "run")
    kept = {k: v for k, v in inputs.params["head"].items() if k != "is_pad"}
    jax.tree.map(np.testing.assert_array_equal, back.params, inputs.params | {"head": kept})
    for got, expected in zip(scaled(back), scaled(inputs), strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-6)


@pytest.mark.parametrize(("settings", "why"), [
    (with_conditioning(settings_for("act"), "late"), "network is late, not none"),
    (settings_for("act", image_positions="learned"), "image_positions is learned, not sine"),
    (settings_for("act", encoder_width=32), "encoder_width is 32, not as width"),
    (settings_for("diffusion", preset="original", crop=0), "features_relu is False, not True"),
    (settings_for("diffusion", chunk=6), "chunk is 6, not a multiple of 4"),
    (settings_for("diffusion", groups=4), "the last norm has 4 groups"),
    (settings_for("diffusion", norm="identity"), "norm is identity, not group or frozen"),
    (settings_for("diffusion", preset="laptop", features=8), "encoder is small, not resnet18"),
])  # fmt: skip
def test_what_has_no_place_there_is_told(tmp_path, settings, why):
    with pytest.raises(CheckpointError, match="no place for this policy") as error:
        export_policy(inputs_of(settings, draw=lambda policy: {}), tmp_path / "out")
    assert why in str(error.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["act", "diffusion"])
def test_every_setting_of_lerobots_is_written_out(name):
    """Defaults move: in 0.6.1 those of Diffusion Policy's encoder did."""
    theirs = json.loads((places.GOLDEN / "lerobot_fields.json").read_text())[name]["config"]
    settings: Any = settings_for(name)
    spec = PolicySpec(ACTION, PROPRIO, 2, SIDE, SIDE, settings.chunk, settings.obs_steps)
    assert config_of(settings, spec).keys() == theirs.keys()
    assert config_of(settings, spec)["pretrained_backbone_weights"] is None


def test_batch_norms_and_other_groups_there_and_back(tmp_path):
    inputs = inputs_of(settings_for("diffusion", norm="frozen", groups=4, last_groups=8))
    [note] = export_policy(inputs, tmp_path / "out")
    assert "Batch norms" in note
    back = read_foreign(tmp_path / "out")
    assert (back.settings.norm, back.settings.groups, back.settings.last_groups) == ("frozen", 4, 8)
    for got, expected in zip(
        jax.tree.leaves(back.params), jax.tree.leaves(inputs.params), strict=True
    ):
        np.testing.assert_allclose(got, expected, rtol=1e-6)


def test_what_differs_there_is_told(tmp_path):
    inputs = inputs_of(settings_for("act", compute_dtype="bfloat16"), ensemble=0.01)
    deltas, rounding = export_policy(inputs, tmp_path / "out")
    assert "averages deltas" in deltas
    assert "computes in bfloat16" in rounding


def test_oblong_images_are_taken(tmp_path):
    export_policy(inputs_of(settings_for("act")), tmp_path / "out")
    inputs = json.loads((tmp_path / "out/config.json").read_text())["input_features"]
    inputs["observation.images.view_0"]["shape"] = [3, 96, 128]
    edited(tmp_path / "out", input_features=inputs)
    adopt(tmp_path / "out", TrainConfig(run_dir=str(tmp_path / "run")))
    assert read_config(tmp_path / "run").resolution == "96x128"


def edited(folder, **changes):
    file = folder / "config.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | changes))


def test_what_has_no_place_here_is_told(tmp_path):
    out = tmp_path / "out"
    export_policy(inputs_of(settings_for("act")), out)
    run = TrainConfig(run_dir=str(tmp_path / "run"))
    edited(out, vision_backbone="resnet34")
    with pytest.raises(CheckpointError, match="vision_backbone is 'resnet34', not resnet18"):
        adopt(out, run)
    edited(out, vision_backbone="resnet18", dim_feedforward=48)
    with pytest.raises(CheckpointError, match=r"linear1.*expected \(48, 16\), got \(24, 16\)"):
        adopt(out, run)
    edited(out, dim_feedforward=24)
    with pytest.raises(CheckpointError, match="actions of 7, but lift in joint_abs has 8"):
        adopt(out, replace(run, action_space="joint_abs"))
    with pytest.raises(CheckpointError, match="action_space eef_delta, as its jaxcam"):
        adopt(out, replace(run, action_space="eef_abs"))
    about = json.loads((out / "jaxcam.json").read_text()) | {"action_space": "eef_abs"}
    del about["rotations"]  # as version 0.1.0 wrote it
    (out / "jaxcam.json").write_text(json.dumps(about))
    with pytest.raises(CheckpointError, match="give --rotations world"):
        adopt(out, replace(run, action_space="eef_abs"))
    with pytest.raises(CheckpointError, match="exists"):
        export_policy(inputs_of(settings_for("act")), out)
    with pytest.raises(CheckpointError, match="no LeRobot checkpoint"):
        adopt(tmp_path, run)
    assert not (tmp_path / "run").exists()
    with pytest.raises(CheckpointError, match="is a folder"):
        read_weights(Path(WeightsConfig(str(out)).source))
