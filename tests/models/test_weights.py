"""Files of weights: reading, recognising, loading, refusing."""

import json
import pickle
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from places import GOLDEN
from policy_inputs import make_stats, shapes

from jaxcam.config.train import TrainConfig
from jaxcam.errors import CheckpointError, ConfigError
from jaxcam.models import ACT_PRESETS, PolicySpec, make_policy
from jaxcam.models.conditioning import with_conditioning
from jaxcam.models.smolvla.config import SMOLVLA_PRESETS
from jaxcam.models.weights.load import Weights, load, read_weights, record_weights, show
from jaxcam.models.weights.names import MAPS, recognise
from jaxcam.models.weights.torch_files import read_torch
from jaxcam.pipeline import starting_weights, train
from jaxcam.runs.identity import resolve

LONG = f"tokens={(1,) * 49}"
FILES = GOLDEN
SMOLVLA = {m.title: m for m in MAPS}["SmolVLA (LeRobot)"]


def weights_of(arrays):
    return Weights(Path("file.pth"), arrays, recognise(list(arrays)), "")


def resnet(d_in=3):
    """A ResNet-18 as torchvision stores it, every number random."""
    rng = np.random.default_rng(0)
    arrays = {"conv1.weight": rng.normal(size=(64, d_in, 7, 7)), "fc.weight": np.zeros((1000, 512))}

    def norm(name, width):
        for part in ("weight", "bias", "running_mean"):
            arrays[f"{name}.{part}"] = rng.normal(size=width)
        arrays[f"{name}.running_var"] = rng.uniform(0.5, 2, width)
        arrays[f"{name}.num_batches_tracked"] = np.array(7)

    norm("bn1", 64)
    for i, (a, b) in enumerate(((64, 64), (64, 128), (128, 256), (256, 512)), 1):
        for block, d_from in enumerate((a, b)):
            name = f"layer{i}.{block}"
            arrays[f"{name}.conv1.weight"] = rng.normal(size=(b, d_from, 3, 3))
            arrays[f"{name}.conv2.weight"] = rng.normal(size=(b, b, 3, 3))
            norm(f"{name}.bn1", b)
            norm(f"{name}.bn2", b)
            if d_from != b:
                arrays[f"{name}.downsample.0.weight"] = rng.normal(size=(b, d_from, 1, 1))
                norm(f"{name}.downsample.1", b)
    return {k: v.astype(np.float32) for k, v in arrays.items()}


def act(conditioning="late", **changes):
    sizes = {"width": 16, "heads": 2, "hidden": 16, "layers": 1, "latent_layers": 1, "chunk": 4}
    config = with_conditioning(ACT_PRESETS["paper"], conditioning)
    config = replace(config, **({"norm": "frozen", "encoder_width": 16} | sizes | changes))
    return zeros(make_policy(config, PolicySpec(3, 5, 1, 64, 64, 4), make_stats()))


def zeros(policy):
    return jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes(policy))


@pytest.mark.parametrize("name", ["weights.pth", "weights_legacy.pth"])
def test_torch_files_are_read_without_torch(name):
    arrays = read_torch(FILES / name)
    table = np.arange(24, dtype=np.float32).reshape(4, 6)
    np.testing.assert_array_equal(arrays["net.plain"], table)
    np.testing.assert_array_equal(arrays["net.turned"], table.T[1:3])
    assert arrays["net.scalar"] == 7
    assert arrays["net.scalar"].dtype == np.int64
    assert arrays["net.empty"].shape == (0, 3)
    assert arrays["net.half"].dtype == np.float16
    np.testing.assert_array_equal(arrays["net.half"], [1.5, -2])
    np.testing.assert_array_equal(arrays["net.brain"].astype(np.float32), [1.5, -3])
    np.testing.assert_array_equal(arrays["net.flags"], [True, False])
    np.testing.assert_array_equal(arrays["net.parameter"], [1, 1])
    np.testing.assert_array_equal(arrays["list.0"], [9])
    assert len(arrays) == 9


class Evil:
    """Runs a command when it is unpickled."""

    def __reduce__(self):
        return print, ("PWNED",)


def test_a_pickle_that_runs_something_is_refused(tmp_path, capsys):
    file = tmp_path / "evil.pth"
    parts = [0x1950A86A20F9469CFC6C, 1001, {"little_endian": True}, {"model": Evil()}]
    file.write_bytes(b"".join(pickle.dumps(part, 2) for part in parts))
    with pytest.raises(CheckpointError, match=r"print.*torch\.save"):
        read_weights(file)
    assert "PWNED" not in capsys.readouterr().out


@pytest.mark.parametrize("name", ["weights.pth", "weights_legacy.pth"])
def test_a_torn_file_is_refused(tmp_path, name):
    whole = (FILES / name).read_bytes()
    for share in (0.2, 0.6, 0.95):
        (tmp_path / name).write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(CheckpointError, match="not a whole PyTorch file"):
            read_torch(tmp_path / name)


def test_missing_file_and_damaged_safetensors(tmp_path):
    with pytest.raises(CheckpointError, match="There is no file"):
        read_weights(tmp_path / "none.pth")
    pytest.importorskip("safetensors")
    (tmp_path / "bad.safetensors").write_bytes(b"12345678" * 4)
    with pytest.raises(CheckpointError, match=r"not a whole \.safetensors"):
        read_weights(tmp_path / "bad.safetensors")


def test_safetensors_are_read_and_hashed(tmp_path, capsys):
    numpy = pytest.importorskip("safetensors.numpy")
    file = tmp_path / "model.safetensors"
    numpy.save_file({"conv1.weight": np.ones((2, 3), np.float32)}, file)
    weights = read_weights(file)
    assert weights.arrays["conv1.weight"].shape == (2, 3)
    assert weights.kind is not None
    show(weights)
    told = capsys.readouterr().out
    assert "conv1.weight" in told
    assert "2x3" in told
    assert "ResNet-18 (torchvision), 1 arrays, 6 numbers" in told.replace("\n", " ")
    assert weights.sha256 in told.replace("\n", "")


def test_resnet_of_torchvision_goes_into_the_image_encoder():
    theirs = resnet()
    loaded = load(weights_of(theirs), act())
    image = loaded["vision"]["image"]
    np.testing.assert_array_equal(
        image["stem"]["kernel"], theirs["conv1.weight"].transpose(2, 3, 1, 0)
    )
    block = image["blocks"]["4"]  # The first of the third layer.
    np.testing.assert_array_equal(
        block["shortcut"]["kernel"], theirs["layer3.0.downsample.0.weight"].transpose(2, 3, 1, 0)
    )
    x = np.random.default_rng(1).normal(size=256).astype(np.float32)
    bn = {k: theirs[f"layer3.0.bn2.{k}"] for k in ("weight", "bias", "running_mean", "running_var")}
    normed = (x - bn["running_mean"]) / np.sqrt(bn["running_var"] + 1e-5) * bn["weight"]
    norm = block["norm2"]
    np.testing.assert_allclose(
        x * norm["frozen_scale"] + norm["frozen_bias"], normed + bn["bias"], rtol=1e-5, atol=1e-5
    )
    assert not np.any(loaded["head"]["action"]["kernel"])


def test_r3m_goes_there_too_without_its_language_model():
    theirs = resnet()
    r3m = {f"r3m.module.convnet.{k}": v for k, v in theirs.items() if not k.startswith("fc")}
    r3m["r3m.module.lang_enc.model.weight"] = np.ones(3, np.float32)
    weights = weights_of(r3m)
    assert weights.kind.title == "ResNet-18 (R3M)"
    loaded, plain = load(weights, act()), load(weights_of(theirs), act())
    jax.tree.map(np.testing.assert_array_equal, loaded, plain)


def test_early_fusion_keeps_the_colours_of_the_kernel_unless_told_otherwise():
    theirs, params = resnet(), act("early")
    kernel = load(weights_of(theirs), params)["vision"]["image"]["stem"]["kernel"]
    assert kernel.shape == (7, 7, 9, 64)
    expected = theirs["conv1.weight"].transpose(2, 3, 1, 0)
    np.testing.assert_array_equal(kernel[:, :, :3], expected)
    assert not np.any(kernel[:, :, 3:])
    new = load(weights_of(theirs), params, new_stem=True)
    assert not np.any(new["vision"]["image"]["stem"]["kernel"])
    assert np.any(new["vision"]["image"]["blocks"]["0"]["conv1"]["kernel"])


def test_errors_list_what_is_missing_extra_and_of_another_shape():
    arrays = resnet()
    arrays["layer1.2.conv1.weight"] = arrays["layer1.1.conv1.weight"]  # ResNet-34 has it.
    del arrays["layer2.0.conv2.weight"]
    arrays["layer4.1.conv1.weight"] = np.zeros((512, 512, 1, 1), np.float32)
    with pytest.raises(CheckpointError) as error:
        load(weights_of(arrays), act())
    for part in (
        r"looks like ResNet-18 (torchvision), but is not this network",
        "1 names are missing: layer2.0.conv2.weight",
        "1 names have no place here: layer1.2.conv1.weight",
        "layer4.1.conv1.weight (expected (512, 512, 3, 3), got (512, 512, 1, 1))",
    ):
        assert part in str(error.value)


def test_norms_without_statistics_have_no_place_for_them():
    with pytest.raises(CheckpointError, match="norm=frozen"):
        load(weights_of(resnet()), act(norm="identity"))


def test_unknown_and_misplaced_weights_are_refused():
    with pytest.raises(CheckpointError, match=r"unknown kind.*begin with a\.b"):
        load(weights_of({"a.b": np.zeros(1)}), act())
    with pytest.raises(CheckpointError, match="has no place for it"):
        load(weights_of(resnet()), tiny_smolvla())


def tiny_smolvla():
    spec = PolicySpec(3, 5, 1, 64, 64, 4)
    config = replace(SMOLVLA_PRESETS["tiny"], chunk=4)
    return zeros(make_policy(config, spec, make_stats()))


def smolvla_arrays(params):
    """What LeRobot would store of such a policy."""
    arrays = {}
    for path, leaf in jax.tree_util.tree_flatten_with_path(params)[0]:
        keys = tuple(step.key for step in path)
        if (name := SMOLVLA.theirs(keys)) is None:
            continue
        axes = {2: (1, 0), 4: (3, 2, 0, 1)}[leaf.ndim] if keys[-1] == "kernel" else None
        arrays[f"model.{name}"] = np.ones_like(leaf if axes is None else leaf.transpose(axes))
    arrays["model.vlm_with_expert.vlm.lm_head.weight"] = np.ones((8, 48), np.float32)
    return arrays


def test_half_converted_names_are_told():
    params = tiny_smolvla()
    arrays = smolvla_arrays(params)
    half = {k.replace("self_attn.q_proj", "query"): v for k, v in arrays.items()}
    with pytest.raises(CheckpointError) as error:
        load(weights_of(half), params)
    assert "8 names are missing" in str(error.value)
    assert "8 names have no place here" in str(error.value)


def test_vision_language_model_leaves_the_expert_alone():
    params = tiny_smolvla()
    cut = "model.vlm_with_expert.vlm."
    arrays = {k.removeprefix(cut): v for k, v in smolvla_arrays(params).items() if cut in k}
    arrays["model.text_model.layers.31.mlp.up_proj.weight"] = np.ones((96, 48), np.float32)
    weights = weights_of(arrays)
    assert weights.kind.title == "SmolVLM2"
    loaded = load(weights, params)
    ones = {k: all(np.all(x == 1) for x in jax.tree.leaves(v)) for k, v in loaded.items()}
    assert {k for k, v in ones.items() if v} == {"vision", "connector", "embed", "text"}
    assert not any(np.any(x) for x in jax.tree.leaves(loaded["expert"]))


def test_what_cannot_be_trained_is_told_before_anything_is_made(tmp_path):
    folders = {"data_dir": str(tmp_path / "data"), "run_dir": str(tmp_path / "run")}
    with pytest.raises(CheckpointError, match="unknown kind"):
        train(TrainConfig(preset="laptop", weights=str(FILES / "weights.pth"), **folders))
    with pytest.raises(ConfigError, match="multiples of 4"):
        train(TrainConfig(preset="laptop", resolution=85, **folders))
    with pytest.raises(ConfigError, match="takes 48"):
        train(
            TrainConfig(policy="smolvla", preset="tiny", model=(f"tokens={(1,) * 49}",), **folders)
        )
    assert not list(tmp_path.iterdir())


def test_weights_that_fit_are_recorded_and_only_read_for_a_new_run(tmp_path):
    numpy = pytest.importorskip("safetensors.numpy")
    file = tmp_path / "resnet.safetensors"
    numpy.save_file(resnet(), file)
    network = ("width=16", "encoder_width=16", "heads=2", "hidden=16", "layers=1", "chunk=4")
    config = TrainConfig(preset="lerobot", resolution=64, model=network, weights=str(file))
    config = resolve(config, accelerator=False)
    assert "-resnet-" in config.run_dir
    config = replace(config, run_dir=str(tmp_path))
    weights = starting_weights([config])
    record_weights(tmp_path, weights)
    record = json.loads((tmp_path / "weights.json").read_text())
    assert record == {"file": str(file), "kind": weights.kind.title, "sha256": weights.sha256}
    (tmp_path / "checkpoints/1").mkdir(parents=True)
    assert starting_weights([config]) is None
