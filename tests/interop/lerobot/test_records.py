"""Every setting of LeRobot's has a meaning here, or none that matters, and is of its type."""

import json
from dataclasses import MISSING, fields

import numpy as np
import pytest
from lerobot_folders import CONFIGS, config_of, edited, write_folder

from jaxcam.errors import CheckpointError, ConfigError
from jaxcam.interop.lerobot.counterparts import COUNTERPARTS, policy_file
from jaxcam.interop.lerobot.layout import settings_of, spec_of
from jaxcam.interop.lerobot.policy import describe_checkpoint, read_foreign
from jaxcam.interop.lerobot.records import MOST_BYTES

safetensors = pytest.importorskip("safetensors.numpy")
WRITTEN = [(version, kind) for version, kinds in CONFIGS.items() for kind in kinds]
REFUSED = (CheckpointError, ConfigError)


def meaning(kind, config):
    """Our settings and sizes of a config, without what only pipelines say."""
    theirs = policy_file(config)
    return settings_of(theirs), spec_of(theirs)


@pytest.mark.parametrize("kind", COUNTERPARTS)
def test_every_setting_has_one_place(kind):
    counterpart = COUNTERPARTS[kind]
    places = (counterpart.same, counterpart.only, counterpart.alone, counterpart.free)
    listed = [name for place in places for name in place]
    known = [f.name for f in fields(counterpart.record)]
    assert sorted(listed) == sorted(known)
    assert all(counterpart.free.values())
    written = {name for version in CONFIGS for name in CONFIGS[version][kind]}
    assert written == set(known)


def other(value):
    """Another value of the same type."""
    match value:
        case bool():
            return not value
        case int():
            return value + 2
        case float():
            return value / 2
        case str():
            return value + "x"
        case list():
            return [part / 2 if isinstance(part, float) else part + 2 for part in value]
    raise TypeError(value)


# Where the rule above gives a value of no type, or one that has a meaning of its own.
OTHERS = {
    "tags": ["a"], "license": "mit", "private": True, "repo_id": "a/b", "pretrained_path": "there",
    "pretrained_revision": "main", "pretrained_backbone_weights": "IMAGENET1K_V1",
    "resize_shape": [32, 32], "crop_shape": [48, 48], "num_inference_steps": 7,
    "temporal_ensemble_coeff": 0.01, "rtc_config": {"enabled": True},
    "normalization_mapping": {"STATE": "IDENTITY"}, "attention_mode": "self_attn",
    "noise_scheduler_type": "DDIM", "n_heads": 4, "horizon": 128, "num_expert_layers": 8,
    "tokenizer_max_length": 24, "n_action_steps": 3, "down_dims": [16, 32], "n_groups": 4,
    "input_features": {}, "output_features": {},
}  # fmt: skip
SINGLE = [
    (kind, name) for kind in COUNTERPARTS for name in CONFIGS["0.6.1"][kind] if name != "type"
]


@pytest.mark.parametrize(("kind", "name"), SINGLE, ids=[f"{k}-{n}" for k, n in SINGLE])
def test_one_setting_changed_is_represented_refused_or_free(kind, name):
    """What comes out, `test_lerobot_fields.py` holds against LeRobot's own numbers."""
    usual, counterpart = config_of(kind), COUNTERPARTS[kind]
    changed = usual | {name: OTHERS[name] if name in OTHERS else other(usual[name])}
    assert changed[name] != usual[name]
    if name == "temporal_ensemble_coeff":
        changed["n_action_steps"] = usual["n_action_steps"] = 1
        policy_file(changed)  # the run's setting, not the policy's
        return
    before, after, why = meaning(kind, usual), None, ""
    try:
        after = meaning(kind, changed)
    except REFUSED as error:
        why = str(error)
    if name in counterpart.free:
        assert after == before
    elif name in counterpart.only:
        assert name in why
    elif after is None:
        assert name.removesuffix("_features") in why
    else:
        assert after != before


@pytest.mark.parametrize(("version", "kind"), WRITTEN)
def test_lerobots_own_defaults_have_a_place_here(version, kind):
    settings, spec = meaning(kind, config_of(kind, version))
    assert settings.obs_steps == spec.obs_steps
    assert (
        settings.padding
        == {
            "act": {"0.4.4": "zeroed", "0.6.1": "valid"},
            "smolvla": {"0.4.4": "counted", "0.6.1": "valid"},
            "diffusion": {"0.4.4": "counted", "0.6.1": "counted"},
        }[kind][version]
    )


@pytest.mark.parametrize("kind", COUNTERPARTS)
def test_what_is_unknown_or_missing_is_named(kind):
    with pytest.raises(ConfigError, match="new_setting"):
        policy_file(config_of(kind, new_setting=0))
    needed = [f.name for f in fields(COUNTERPARTS[kind].record) if f.default is MISSING]
    for name in needed[1:]:
        config = config_of(kind)
        del config[name]
        with pytest.raises(ConfigError, match=f"has no '{name}'"):
            policy_file(config)


def test_of_another_policy_another_setting_is_unknown():
    with pytest.raises(ConfigError, match="gradient_checkpointing"):
        policy_file(config_of("act", gradient_checkpointing=True))


HUGE = [
    (kind, name)
    for kind in COUNTERPARTS
    for name, value in CONFIGS["0.6.1"][kind].items()
    if type(value) is int and name not in COUNTERPARTS[kind].free
]


@pytest.mark.parametrize(("kind", "name"), HUGE, ids=[f"{k}-{n}" for k, n in HUGE])
def test_huge_and_impossible_sizes_are_refused_before_anything_is_made(kind, name):
    for size in (10**9, 10**7, 2**70, -1, 1.5, float("nan"), "9", None, [3]):
        free = name in ("num_expert_layers", "tokenizer_max_length") and size != 2**70
        if free and type(size) is int:
            continue  # no size of ours
        with pytest.raises(REFUSED) as error:
            meaning(kind, config_of(kind, **{name: size}))
        assert name in str(error.value)


@pytest.mark.parametrize(("kind", "array", "changes", "name"), [
    ("act", "model.encoder_latent_input_proj.weight", {"n_encoder_layers": 99}, "dim_model"),
    ("act", "model.encoder_latent_input_proj.weight", {"chunk_size": 9999}, "chunk_size"),
    ("diffusion", "diffusion.unet.diffusion_step_encoder.1.weight", {"down_dims": [8192] * 6},
     "down_dims"),
])  # fmt: skip
def test_no_network_is_laid_out_of_sizes_that_no_array_has(tmp_path, kind, array, changes, name):
    folder = write_folder(tmp_path / "a", kind, **changes)
    arrays = {array: np.zeros((512, 4), np.float32)}
    if name == "dim_model":
        arrays = {array: np.zeros((5, 4), np.float32), "a": np.zeros(300, np.float32)}
    safetensors.save_file(arrays, folder / "model.safetensors")
    with pytest.raises(CheckpointError, match=f"{name} is .*, more than its weights have"):
        read_foreign(folder)


@pytest.mark.parametrize("shape", [
    [3, 10**6, 10**6], [3], [], [3, 64], [3, -64, 64], [3, 64.0, 64], "3", [3, None, 4], [[3]],
    [1, 64, 64], [10**9, 64, 64],
])  # fmt: skip
def test_shapes_that_cannot_be_are_refused(shape):
    config = config_of("act")
    config["input_features"]["observation.images.view_0"]["shape"] = shape
    with pytest.raises(REFUSED, match=r"observation\.images\.view_0"):
        meaning("act", config)
    config = config_of("act")
    config["output_features"]["action"]["shape"] = [7, 2]
    with pytest.raises(CheckpointError, match="action has the shape"):
        meaning("act", config)


def test_many_features_and_large_files_are_refused(tmp_path):
    many = {f"observation.images.{i}": {"type": "VISUAL", "shape": [3, 64, 64]} for i in range(999)}
    with pytest.raises(ConfigError, match="input_features are 999"):
        policy_file(config_of("act", input_features=many))
    folder = write_folder(tmp_path / "a", "act")
    with (folder / "config.json").open("wb") as file:
        file.truncate(MOST_BYTES + 1)
    with pytest.raises(ConfigError, match=f"has {MOST_BYTES + 1} bytes"):
        read_foreign(folder)


def test_a_feature_of_another_kind_is_not_scaled_as_an_action(tmp_path):
    """LeRobot passes observations of the kind ACTION over."""
    folder = write_folder(tmp_path / "a", "act")

    def as_action(content):
        content["steps"][3]["config"]["features"]["observation.state"]["type"] = "ACTION"

    edited(folder, "policy_preprocessor.json", as_action)
    assert set(describe_checkpoint(folder).stats["proprio_std"]) == {1}


@pytest.mark.parametrize(("change", "why"), [
    (lambda c: c.update(steps={}), "steps must be list"),
    (lambda c: c["steps"].append(7), "a step of .* JSON int"),
    (lambda c: c["steps"].append({"class": "lerobot.x.Y"}), "the step 'lerobot.x.Y'"),
    (lambda c: c["steps"].append({"registry_name": ["x"]}), "registry_name must be"),
    (lambda c: c["steps"][3].update(config={}), "step 'normalizer_processor'.* has no 'features'"),
    (lambda c: c["steps"][3]["config"].update(norm_map={"STATE": 3}), "norm_map must be str"),
    (lambda c: c["steps"][3]["config"].update(eps=float("nan")), "must be finite"),
    (lambda c: c["steps"][3]["config"].update(clip=1), "clip"),
    (lambda c: c["steps"][3].update(state_file="../x.safetensors"), "no file of statistics"),
    (lambda c: c["steps"][3].update(state_file="x" * 5000), "no file of statistics 'xxx"),
    (lambda c: c["steps"][3]["config"].update(norm_map={"STATE": "MAX"}), "Unknown norm_map 'MAX'"),
    (lambda c: c["steps"][3].update(state_file=5), "state_file must be"),
])  # fmt: skip
def test_pipelines_of_another_form_are_refused(tmp_path, change, why):
    folder = write_folder(tmp_path / "a", "act")
    edited(folder, "policy_preprocessor.json", change)
    with pytest.raises(REFUSED, match=why):
        describe_checkpoint(folder)


def test_statistics_that_are_none_are_refused(tmp_path):
    folder = write_folder(tmp_path / "a", "act")
    [file] = folder.glob("policy_preprocessor*.safetensors")
    for content in (b"", b"\x00" * 64, b"version https://git-lfs.github.com/spec/v1\n"):
        file.write_bytes(content)
        with pytest.raises(CheckpointError, match=r"policy_preprocessor.*\.safetensors"):
            describe_checkpoint(folder)


def test_healthy_folders_are_described(tmp_path):
    """So that what the others refuse is refused for what they changed."""
    for kind in ("act", "diffusion"):
        described = describe_checkpoint(write_folder(tmp_path / kind, kind))
        assert described.settings.image_scaling == "imagenet"
        assert json.dumps(described.theirs.written())
    with pytest.raises(CheckpointError, match="--policy smolvla --preset lerobot"):
        describe_checkpoint(write_folder(tmp_path / "smolvla", "smolvla"))
