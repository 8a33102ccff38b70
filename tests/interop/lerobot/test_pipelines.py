"""Each setting of a LeRobot policy by itself: what comes out is LeRobot's, or it is refused.

`tests/golden/make_lerobot_fields.py` made LeRobot's numbers.
"""

import gzip
import json
import zlib

import numpy as np
import pytest
from places import GOLDEN

from jaxcam.errors import CheckpointError, ConfigError
from jaxcam.interop.lerobot.pipelines import write_pipelines
from jaxcam.interop.lerobot.policy import read_foreign
from jaxcam.models import make_policy

safetensors = pytest.importorskip("safetensors.numpy")

LATER = json.loads(gzip.decompress((GOLDEN / "lerobot_fields_0.6.json.gz").read_bytes()))
THEIRS = json.loads((GOLDEN / "lerobot_fields.json").read_text()) | {
    f"{kind}-0.6": record for kind, record in LATER.items()
}
"""Of 0.4.4 every setting; of 0.6.1 its own defaults, and what is new or moved in it."""
STATE, ACTION, VIEWS, SIDE = 11, 7, 2, 64
CASES = [
    (kind, f"{i}-{case['field']}", case)
    for kind, record in THEIRS.items()
    for i, case in enumerate([{"field": "usual", **record}, *record["cases"]])
]
REFUSED = {
    "act": {
        "use_amp", "use_peft", "n_obs_steps", "vision_backbone", "n_decoder_layers", "use_vae",
        "replace_final_stride_with_dilation", "feedforward_activation",
    },
    "diffusion": {
        "use_amp", "use_peft", "vision_backbone", "resize_shape", "use_film_scale_modulation",
        "beta_schedule", "prediction_type", "clip_sample", "clip_sample_range",
    },
}  # fmt: skip
"""Settings of which only the usual value has a place here, each by its name."""
REFUSED |= {f"{kind}-0.6": set() for kind in LATER}


def weight(name, shape):
    """The same as in `make_lerobot_fields.py`."""
    values = np.random.RandomState(zlib.crc32(name.encode())).normal(size=shape)
    if name.endswith("running_var"):
        return (1 + 0.5 * np.abs(values)).astype(np.float32)
    if len(shape) > 1:
        return (values * np.sqrt(1.5 / np.prod(shape[1:]))).astype(np.float32)
    return (0.1 * values + name.endswith("weight")).astype(np.float32)


def statistics():
    """The same as in `make_lerobot_fields.py`: one number never varied, one hardly."""
    rng, stats = np.random.RandomState(0), {}
    for name, size in (("observation.state", STATE), ("action", ACTION)):
        low, width = rng.normal(size=size), rng.uniform(0.5, 2, size)
        width[:2] = 0, 5e-4
        values = {"mean": low + width / 2, "std": width / 3, "min": low, "max": low + width}
        stats |= {f"{name}.{k}": v.astype(np.float32) for k, v in values.items()}
    for view in range(VIEWS):
        pair = {"mean": (0.485, 0.456, 0.406), "std": (0.229, 0.224, 0.225)}
        for k, v in pair.items():
            name = f"observation.images.view_{view}.{k}"
            stats[name] = np.reshape(v, (3, 1, 1)).astype(np.float32)
    return stats


def observation(steps, views):
    """The same as in `make_lerobot_fields.py`, with a batch axis and cameras."""
    rng, stats = np.random.RandomState(1), statistics()
    drawn = rng.normal(size=(2, STATE))[:steps]
    image = rng.randint(0, 256, (2, VIEWS, SIDE, SIDE, 3)).astype(np.uint8)[:steps]
    state = stats["observation.state.mean"] + stats["observation.state.std"] * drawn
    camera = np.broadcast_to(np.eye(4, dtype=np.float32), (steps, VIEWS, 4, 4))
    obs = {"image": image, "proprio": state.astype(np.float32)}
    K = np.array([[SIDE, 0, SIDE / 2], [0, SIDE, SIDE / 2], [0, 0, 1]], np.float32)
    obs |= {"K": np.broadcast_to(K, (steps, VIEWS, 3, 3)), "base_from_camera": camera}
    obs |= {k: obs[k][:, :views] for k in ("image", "K", "base_from_camera")}
    return {k: v[None] if steps > 1 else v for k, v in obs.items()}


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A file of weights of given shapes, made once."""
    folder, drawn, files = tmp_path_factory.mktemp("weights"), {}, {}

    def made(shapes):
        name = json.dumps(shapes)
        if name not in files:
            for key in ((n, tuple(s)) for n, s in shapes.items()):
                drawn.setdefault(key, weight(*key))
            files[name] = folder / f"{len(files)}.safetensors"
            arrays = {n: drawn[n, tuple(s)] for n, s in shapes.items()}
            safetensors.save_file(arrays, files[name])
        return files[name]

    return made


def checkpoint(folder, kind, case, weights, stats=None):
    """A checkpoint as LeRobot would have written it."""
    config = THEIRS[kind]["config"] | case["config"]
    (folder / "config.json").write_text(json.dumps(config))
    write_pipelines(folder, config, statistics() if stats is None else stats)
    file = weights(case.get("shapes", THEIRS[kind]["shapes"]))
    (folder / "model.safetensors").hardlink_to(file)
    return folder


def actions(folder, known={}):  # noqa: B006
    """What our policy does with a checkpoint, without noise; what is the same is computed once."""
    foreign = read_foreign(folder)
    numbers = b"".join(foreign.stats[k].tobytes() for k in sorted(foreign.stats))
    key = (foreign.settings, foreign.spec, foreign.weights.sha256, numbers)
    if key not in known:
        policy = make_policy(foreign.settings, foreign.spec, foreign.stats)
        observed = observation(foreign.spec.obs_steps, foreign.spec.views)
        chunk = policy.act(foreign.params, observed, None)
        known[key] = np.asarray(chunk)[0, : policy.execute]
    return known[key]


def close(ours, theirs):
    theirs = np.array(theirs)
    assert ours.shape == theirs.shape
    np.testing.assert_allclose(ours, theirs, atol=1e-4 * np.abs(theirs).max())


@pytest.mark.parametrize(("kind", "name", "case"), CASES, ids=[f"{k}-{n}" for k, n, _ in CASES])
def test_each_setting_is_the_same_or_refused(tmp_path, weights, kind, name, case):
    del name
    is_oblong = case["config"].get("crop_shape") == [40, 56]
    if case["actions"] is None or case["field"] in REFUSED[kind] or is_oblong:
        case = {**case, "shapes": THEIRS[kind]["shapes"]}  # which nobody comes to read
        with pytest.raises((CheckpointError, ConfigError)) as error:
            read_foreign(checkpoint(tmp_path, kind, case, weights))
        assert case["field"] in str(error.value)
    else:
        close(actions(checkpoint(tmp_path, kind, case, weights)), case["actions"])


def test_most_settings_have_a_place_here():
    for kind, record in THEIRS.items():
        varied = {case["field"] for case in record["cases"]}
        assert varied >= REFUSED[kind]
        assert len(REFUSED[kind]) < len(varied) / 3


def edited(folder, name, change):
    """A file of a checkpoint, changed."""
    content = json.loads((folder / name).read_text())
    change(content)
    (folder / name).write_text(json.dumps(content))


def usual(folder, kind, weights, stats=None):
    return checkpoint(folder, kind, THEIRS[kind] | {"config": {}}, weights, stats)


@pytest.mark.parametrize("kind", ["act", "diffusion"])
def test_statistics_that_its_modes_do_not_use_may_be_missing(tmp_path, weights, kind):
    names = ("mean", "std") if kind == "act" else ("min", "max")
    stats = {k: v for k, v in statistics().items() if k.endswith(names) or "images" in k}
    close(actions(usual(tmp_path, kind, weights, stats)), THEIRS[kind]["actions"])
    del stats[f"observation.state.{names[0]}"]
    (tmp_path / "without").mkdir()
    with pytest.raises(CheckpointError, match=f"'observation.state.{names[0]}'"):
        read_foreign(usual(tmp_path / "without", kind, weights, stats))


def test_pipelines_count_and_not_the_config(tmp_path, weights):
    folder = usual(tmp_path, "act", weights)
    odd = {"VISUAL": "MIN_MAX", "STATE": "IDENTITY", "ACTION": "QUANTILES"}
    edited(folder, "config.json", lambda c: c.update(normalization_mapping=odd))
    close(actions(folder), THEIRS["act"]["actions"])

    def raw_states(content):
        content["steps"][3]["config"]["norm_map"]["STATE"] = "IDENTITY"

    edited(folder, "policy_preprocessor.json", raw_states)
    stats = read_foreign(folder).stats
    np.testing.assert_array_equal(stats["proprio_mean"], np.zeros(STATE))
    np.testing.assert_array_equal(stats["proprio_std"], np.ones(STATE))


@pytest.mark.parametrize(("step", "settings", "why"), [
    ("normalizer_processor", {"eps": 1e-3}, "eps of 'normalizer_processor' is 0.001"),
    ("normalizer_processor", {"normalize_observation_keys": ["a"]}, "normalize_observation_keys"),
    ("normalizer_processor", {"stats": {"action": {}}}, "stats of 'normalizer_processor'"),
    ("normalizer_processor", {"norm_map": {"STATE": "QUANTILES"}}, "state by QUANTILES"),
    ("rename_observations_processor", {"rename_map": {"a": "b"}}, "rename_map"),
    ("device_processor", {"float_dtype": "float16"}, "float_dtype of 'device_processor'"),
    ("relative_actions_processor", {}, "the step 'relative_actions_processor'"),
])  # fmt: skip
def test_steps_that_change_numbers_are_refused_by_name(tmp_path, weights, step, settings, why):
    folder = usual(tmp_path, "act", weights)

    def change(content):
        steps = content["steps"]
        known = [s for s in steps if s["registry_name"] == step]
        if not known:
            steps.append({"registry_name": step, "config": {}})
        for one in known:
            one["config"] |= settings

    edited(folder, "policy_preprocessor.json", change)
    with pytest.raises(CheckpointError, match=why):
        read_foreign(folder)


def test_images_without_statistics_are_taken_as_they_are(tmp_path, weights):
    stats = {k: v for k, v in statistics().items() if "images" not in k}
    assert read_foreign(usual(tmp_path, "act", weights, stats)).settings.image_scaling == "unit"


def without(name):
    return lambda config: config["input_features"].pop(name)


def with_input(name, kind, *shape):
    feature = {"type": kind, "shape": list(shape)}
    return lambda config: config["input_features"].update({name: feature})


def swapped(config):
    inputs = config["input_features"]
    inputs["observation.images.view_0"] = inputs.pop("observation.images.view_0")


@pytest.mark.parametrize(("change", "why"), [
    (without("observation.state"), "input observation.state is missing"),
    (with_input("observation.environment_state", "ENV", 4), "environment_state' is one too many"),
    (with_input("observation.images.view_1", "VISUAL", 3, 64, 80), "view_1 3x64x80"),
    (with_input("observation.images.view_1", "VISUAL", 1, 64, 64), "not .3, height, width"),
    (swapped, "images in another order"),
    (lambda config: config.update(type="pi0"), "It is of policy 'pi0'"),
    (lambda config: config.update(new_setting=1), "Unknown setting 'new_setting'"),
    (lambda config: config.pop("pre_norm"), "has no 'pre_norm'"),
    (lambda config: config.update(temporal_ensemble_coeff=0.0, n_action_steps=1), "coeff is 0"),
])  # fmt: skip
def test_what_has_no_place_here_is_named(tmp_path, weights, change, why):
    folder = usual(tmp_path, "act", weights)
    edited(folder, "config.json", change)
    with pytest.raises((CheckpointError, ConfigError), match=why):
        read_foreign(folder)


def test_a_checkpoint_from_before_pipelines_is_told_how_to_migrate(tmp_path, weights):
    folder = usual(tmp_path, "act", weights)
    (folder / "policy_preprocessor.json").unlink()
    with pytest.raises(CheckpointError, match="migrate_policy_normalization"):
        read_foreign(folder)


def test_differences_that_cannot_be_helped_are_told(tmp_path, weights):
    folder = usual(tmp_path, "act", weights)
    assert read_foreign(folder).notes == []
    ensemble = {"temporal_ensemble_coeff": 0.01, "n_action_steps": 1}
    edited(folder, "config.json", lambda config: config.update(ensemble))
    [note] = read_foreign(folder).notes
    assert "averages deltas" in note


def test_later_versions_leave_padding_out_of_the_loss(tmp_path, weights):
    folder = usual(tmp_path, "act", weights)
    assert read_foreign(folder).settings.padding == "zeroed"
    edited(folder, "config.json", lambda config: config.update(pretrained_revision=None))
    assert read_foreign(folder).settings.padding == "valid"
