"""Weights of others: read, shown, and put into our networks or refused."""

import io
import json
import tracemalloc
from dataclasses import replace

import ml_dtypes
import numpy as np
import pytest
from places import GOLDEN
from rich.console import Console
from stored_weights import act, resnet, tiny_smolvla, weights_of

from jaxcam.config.train import TrainConfig
from jaxcam.errors import CheckpointError, ConfigError
from jaxcam.models.weights.load import load, read_weights, record_weights, show_weights
from jaxcam.pipeline import starting_weights, train
from jaxcam.runs.identity import resolve

FILES = GOLDEN


def test_missing_file_and_damaged_safetensors(tmp_path):
    with pytest.raises(CheckpointError, match="There is no file"):
        read_weights(tmp_path / "none.pth")
    pytest.importorskip("safetensors")
    (tmp_path / "bad.safetensors").write_bytes(b"12345678" * 4)
    with pytest.raises(CheckpointError, match=r"not a whole \.safetensors"):
        read_weights(tmp_path / "bad.safetensors")


def test_safetensors_are_read_and_hashed(tmp_path):
    numpy = pytest.importorskip("safetensors.numpy")
    file = tmp_path / "model.safetensors"
    numpy.save_file({"conv1.weight": np.ones((2, 3), np.float32)}, file)
    weights = read_weights(file)
    assert weights.arrays["conv1.weight"].shape == (2, 3)
    assert weights.kind is not None
    console = Console(file=io.StringIO(), width=300)
    show_weights(weights, console)
    printed = console.file.getvalue()
    assert "conv1.weight" in printed
    assert "2x3" in printed
    assert "ResNet-18 (torchvision), 1 arrays, 6 numbers" in printed.replace("\n", " ")
    assert weights.sha256 in printed.replace("\n", "")


def test_safetensors_of_float8_are_read(tmp_path):
    numbers = np.array([0.5, -2, 3], ml_dtypes.float8_e4m3fn)
    kinds = {"F8_E4M3": numbers, "F32": np.ones(2, np.float32)}
    content, entries = b"", {}
    for kind, array in kinds.items():
        ends = [len(content), len(content) + array.nbytes]
        entries[f"{kind}.weight"] = {"dtype": kind, "shape": [len(array)], "data_offsets": ends}
        content += array.tobytes()
    header = json.dumps(entries).encode()
    pytest.importorskip("safetensors")
    file = tmp_path / "float8.safetensors"
    file.write_bytes(len(header).to_bytes(8, "little") + header + content)
    arrays = read_weights(file).arrays
    assert arrays.keys() == {"F8_E4M3.weight", "F32.weight"}
    np.testing.assert_array_equal(arrays["F8_E4M3.weight"].astype(np.float32), [0.5, -2, 3])
    np.testing.assert_array_equal(arrays["F32.weight"], [1, 1])


def test_safetensors_of_unknown_numbers_are_refused_by_their_header(tmp_path):
    pytest.importorskip("safetensors")
    large = {"dtype": "F32", "shape": [2**18], "data_offsets": [0, 2**20]}
    odd = {"dtype": "F4", "shape": [4], "data_offsets": [2**20, 2**20 + 2]}
    entries = {"large": large, "odd": odd}
    header = json.dumps(entries).encode()
    file = tmp_path / "odd.safetensors"
    file.write_bytes(len(header).to_bytes(8, "little") + header + bytes(2**20 + 2))
    tracemalloc.start()
    with pytest.raises(CheckpointError, match=r"odd \(F4\)"):
        read_weights(file)
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()


def test_weights_that_are_no_fractions_are_refused_by_name():
    for dtype in (np.uint16, np.complex64):
        arrays = resnet()
        arrays["layer1.0.conv1.weight"] = arrays["layer1.0.conv1.weight"].astype(dtype)
        with pytest.raises(CheckpointError, match=rf"layer1\.0\.conv1\.weight \({dtype.__name__}"):
            load(weights_of(arrays), act())


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


def test_unknown_and_misplaced_weights_are_refused():
    with pytest.raises(CheckpointError, match=r"unknown kind.*begin with a\.b"):
        load(weights_of({"a.b": np.zeros(1)}), act())
    with pytest.raises(CheckpointError, match="has no place for it"):
        load(weights_of(resnet()), tiny_smolvla())


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
