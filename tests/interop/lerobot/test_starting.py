"""A run that begins with LeRobot's weights has the settings that they were trained with."""

from dataclasses import replace

import numpy as np
import pytest
from lerobot_folders import edited, write_folder

from jaxcam.errors import CheckpointError, ConfigError
from jaxcam.interop.lerobot.starting import read_start
from jaxcam.models import FAMILIES, Policy, PolicySpec

safetensors = pytest.importorskip("safetensors.numpy")

NAMES = {
    "act": "model.encoder_latent_input_proj.weight",
    "diffusion": "diffusion.unet.diffusion_step_encoder.1.weight",
    "smolvla": "model.vlm_with_expert.vlm.model.connector.modality_projection.proj.weight",
}
"""An array by whose name weights are recognised; no other is looked at here."""


def started(kind, preset="lerobot", **changes):
    """What is to be trained; its network is of no concern."""
    settings = replace(FAMILIES[kind].presets[preset], **changes)  # pyright: ignore
    spec = PolicySpec(7, 11, 1, 64, 64, settings.chunk, settings.obs_steps)

    def nothing(*_):
        raise AssertionError

    return Policy(nothing, nothing, nothing, settings, spec, 1)


def checkpoint(folder, kind, version="0.4.4", **changes):
    write_folder(folder, kind, version, **changes)
    safetensors.save_file({NAMES[kind]: np.zeros((2, 2), np.float32)}, folder / "model.safetensors")
    return folder


@pytest.mark.parametrize("kind", NAMES)
def test_the_same_settings_may_begin_from_the_folder_or_its_file(tmp_path, kind):
    folder = checkpoint(tmp_path / "a", kind)
    for path in (folder, folder / "model.safetensors"):
        weights = read_start(path, started(kind))
        assert list(weights.arrays) == [NAMES[kind]]


@pytest.mark.parametrize(("kind", "changes", "why"), [
    ("act", {"pre_norm": True}, "pre_norm is True there.*--model pre_norm=True"),
    ("act", {"n_heads": 4}, "heads is 4 there.*--model heads=4"),
    ("diffusion", {"crop_shape": [48, 48]}, "--model crop=48"),
    ("diffusion", {"num_train_timesteps": 50}, "noising_steps is 50 there"),
    ("diffusion", {"down_dims": [256, 512]}, r"--model 'channels=\(256,512\)'"),
    ("diffusion", {"use_group_norm": False}, "--model norm=frozen$"),
    ("smolvla", {"attention_mode": "self_attn"}, "attention=joint$"),
    ("smolvla", {"num_vlm_layers": 8}, "--model layers=8"),
    ("smolvla", {"expert_width_multiplier": 0.5}, "--model expert_width=480 expert_hidden=1280"),
    ("smolvla", {"max_period": 8.0}, "max_period is 8.0, not 4.0"),
    ("smolvla", {"adapt_to_pi_aloha": True}, "adapt_to_pi_aloha is True"),
    ("smolvla", {"vlm_model_name": "a/b"}, "vlm_model_name is 'a/b'"),
    ("smolvla", {"resize_imgs_with_padding": [512, 384]}, "resize_imgs_with_padding"),
    ("smolvla", {"normalization_mapping": {"STATE": "MIN_MAX"}}, "scales STATE by 'MIN_MAX'"),
])  # fmt: skip
def test_other_settings_are_refused_with_what_to_do(tmp_path, kind, changes, why):
    folder = checkpoint(tmp_path / "a", kind, **changes)
    with pytest.raises(CheckpointError, match=why):
        read_start(folder / "model.safetensors", started(kind))


@pytest.mark.parametrize(("kind", "changes", "ours"), [
    ("act", {"pre_norm": True}, {"pre_norm": True}),
    ("act", {"dropout": 0.0, "kl_weight": 1.0, "use_amp": True}, {}),
    ("act", {}, {"conditioning": "early", "dropout": 0.3, "execute": 5}),
    ("diffusion", {"noise_scheduler_type": "DDIM", "horizon": 64, "n_action_steps": 32}, {}),
    ("diffusion", {"down_dims": [256, 512]}, {"channels": (256, 512)}),
    ("smolvla", {"num_steps": 5, "prefix_length": 0, "pad_language_to": "max_length"}, {}),
    ("smolvla", {}, {"prompt": "lift it", "steps": 20, "train": "all", "chunk": 30}),
])  # fmt: skip
def test_how_a_run_trains_and_acts_is_its_own(tmp_path, kind, changes, ours):
    folder = checkpoint(tmp_path / "a", kind, **changes)
    assert read_start(folder, started(kind, **ours)).sha256


def test_other_presets_of_the_same_shapes_are_refused(tmp_path):
    folder = checkpoint(tmp_path / "a", "smolvla")
    with pytest.raises(CheckpointError, match=r"mask is 'blocks' there.*Give --preset lerobot"):
        read_start(folder, started("smolvla", "paper"))


@pytest.mark.parametrize(("change", "why"), [
    (lambda s: s["config"].update(max_length=12), "max_length of 'tokenizer_processor' is 12"),
    (lambda s: s["config"].update(padding_side="left"), "padding_side of"),
    (lambda s: s["config"].update(tokenizer_name="a/b"), "tokenizer_name of"),
    (lambda s: s["config"].update(max_length=10**9), "max_length of"),
    (lambda s: s["config"].update(prefix="a"), "prefix"),
])  # fmt: skip
def test_words_are_read_as_ours(tmp_path, change, why):
    folder = checkpoint(tmp_path / "a", "smolvla")
    edited(folder, "policy_preprocessor.json", lambda c: change(c["steps"][-1]))
    with pytest.raises((CheckpointError, ConfigError), match=why):
        read_start(folder, started("smolvla"))


def test_pipelines_that_scale_in_another_way_are_refused(tmp_path):
    folder = checkpoint(tmp_path / "a", "smolvla")

    def change(content):
        content["steps"][3]["config"]["norm_map"]["VISUAL"] = "MEAN_STD"

    edited(folder, "policy_preprocessor.json", change)
    with pytest.raises(CheckpointError, match=r"policy_preprocessor\.json scales VISUAL by"):
        read_start(folder, started("smolvla"))
    folder = checkpoint(tmp_path / "b", "act")
    edited(folder, "policy_preprocessor.json", change)
    with pytest.raises(CheckpointError, match=r"--model image_scaling=imagenet$"):
        read_start(folder, started("act", image_scaling="unit"))


def test_what_does_not_belong_together_is_refused(tmp_path):
    folder = checkpoint(tmp_path / "a", "act")
    with pytest.raises(CheckpointError, match="is of policy act, the run of diffusion"):
        read_start(folder, started("diffusion"))
    checkpoint(folder, "diffusion")
    edited(folder, "config.json", lambda c: c.update(type="act"))
    with pytest.raises(ConfigError, match="Unknown setting"):
        read_start(folder, started("diffusion"))
    (folder / "policy_preprocessor.json").unlink()
    with pytest.raises(CheckpointError, match="migrate_policy_normalization"):
        read_start(folder, started("diffusion"))
    (folder / "config.json").write_text("[")
    with pytest.raises(ConfigError, match=r"config\.json is not JSON"):
        read_start(folder / "model.safetensors", started("diffusion"))


def test_other_weights_and_folders_are_as_they_were(tmp_path):
    arrays = {"conv1.weight": np.zeros((2, 2), np.float32)}
    safetensors.save_file(arrays, tmp_path / "model.safetensors")
    (tmp_path / "config.json").write_text('{"model_type": "resnet"}')
    assert read_start(tmp_path / "model.safetensors", started("act")).kind is not None
    (tmp_path / "config.json").unlink()
    with pytest.raises(CheckpointError, match="is a folder"):
        read_start(tmp_path, started("act"))
