"""Files of weights: reading, recognising, loading, refusing."""

import contextlib
import json
import pickle
import tracemalloc
import zipfile
from dataclasses import replace
from pathlib import Path

import jax
import ml_dtypes
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
from jaxcam.models.weights.names import MAPS, recognise, unwrap
from jaxcam.models.weights.torch_files import MOST_STEPS, read_torch
from jaxcam.pipeline.sources import source_of
from jaxcam.pipeline.train import starting_weights, train
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


@pytest.mark.parametrize("name", ["weights_types.pth", "weights_types_legacy.pth"])
def test_types_that_torch_stores_as_bytes(name):
    arrays = read_torch(FILES / name)
    np.testing.assert_array_equal(arrays["uint16"], np.array([2, 60000], np.uint16))
    np.testing.assert_array_equal(arrays["uint64"], np.array([1, 2**40], np.uint64))
    np.testing.assert_array_equal(arrays["complex"], np.array([0.5j, -2j, 3j], np.complex64))
    assert arrays["e4m3"].dtype == ml_dtypes.float8_e4m3fn
    np.testing.assert_array_equal(arrays["e4m3"].astype(np.float32), [-2, 3])
    assert arrays["e5m2"].dtype == ml_dtypes.float8_e5m2
    np.testing.assert_array_equal(arrays["e5m2"].astype(np.float32), [0.5, -2, 3])


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


def test_a_tensor_of_an_unknown_kind_is_not_called_a_program(tmp_path):
    content = b"\x80\x02" + opcodes("a") + b"ctorch._utils\n_rebuild_sparse_tensor\n)R."
    save_archive(tmp_path / "sparse.pth", content)
    with pytest.raises(CheckpointError, match=r"kind that is not read here.*sparse") as error:
        read_weights(tmp_path / "sparse.pth")
    assert "program" not in str(error.value)


def opcodes(value):
    """What pushes a value in a pickle."""
    return pickle.dumps(value, 2)[2:-1]


def tensor(shape, strides, count=4):
    """What pushes a tensor of float32 whose storage is called 0."""
    storage = opcodes("storage") + b"ctorch\nFloatStorage\n" + opcodes("0") + opcodes("cpu")
    about = opcodes(0) + opcodes(shape) + opcodes(strides)
    storage = b"(" + storage + opcodes(count) + b"tQ"
    hooks = b"\x89ccollections\nOrderedDict\n)R"
    return b"ctorch._utils\n_rebuild_tensor_v2\n(" + storage + about + hooks + b"tR"


def save_archive(path, content, storage=bytes(16), compression=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", compression) as archive:
        archive.writestr("archive/data.pkl", content)
        archive.writestr("archive/data/0", storage)


def nested(depth):
    """Lists of ten times the same list, so deep."""
    value = []
    for _ in range(depth):
        value = [value] * 10
    return value


def cyclic():
    value = []
    value.append(value)
    return value


def copied_lists():
    """Many copies of one long list, each of which takes a few bytes of the pickle."""
    long = b"(" + b"K\x01" * 50_000 + b"lq\x07"
    return b"(" + long + b"ctorch\nSize\nh\x07\x85R" * 20_000 + b"l"


HOSTILE = {
    "a stride of 0": tensor((1_500_000_000,), (0,)),
    "many windows of one storage": b"(" + tensor((4096, 4096), (0, 1), 4096) * 40 + b"l",
    "lists inside of lists": opcodes(nested(30)),
    "a list inside of itself": opcodes(cyclic()),
    "a place far away in the memo": b"]r\xff\xff\xff\x7f",
    "copies of a list": copied_lists(),
    "a long name, many times": opcodes({"x" * 10_000: [[]] * 100_000}),
    "a giant text": b"\x8e" + (2**40).to_bytes(8, "little"),
}


@pytest.mark.parametrize("case", HOSTILE)
@pytest.mark.parametrize("layout", ["zip", "legacy"])
def test_memory_stays_near_the_size_of_the_file(tmp_path, case, layout):
    file, content = tmp_path / "hostile.pth", b"\x80\x02" + HOSTILE[case] + b"."
    if layout == "zip":
        save_archive(file, content, bytes(4 * 4096))
    else:
        head = [pickle.dumps(x, 2) for x in (0x1950A86A20F9469CFC6C, 1001, {"little_endian": True})]
        storage = pickle.dumps(["0"], 2) + (4096).to_bytes(8, "little") + bytes(4 * 4096)
        file.write_bytes(b"".join(head) + content + storage)
    with bounded(400e6), pytest.raises(CheckpointError, match=r"more memory|not a whole"):
        read_weights(file)


def test_a_pickle_without_an_end_is_refused_before_it_is_obeyed(tmp_path):
    content = b"\x80\x02(" + b"}" * (MOST_STEPS + 1) + b"l."
    save_archive(tmp_path / "long.pth", content)
    with pytest.raises(CheckpointError, match="more memory"):
        read_weights(tmp_path / "long.pth")


@contextlib.contextmanager
def bounded(most):
    """Fails where more than so many bytes were taken at once."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()


def test_compressed_storages_of_a_giant_are_refused(tmp_path):
    file = tmp_path / "deflated.pth"
    content = b"\x80\x02}" + opcodes("a") + tensor((4, 2), (2, 1), 8) + b"s."
    save_archive(file, content, bytes(100_000_000), zipfile.ZIP_DEFLATED)
    with bounded(50e6), pytest.raises(CheckpointError, match="more memory"):
        read_weights(file)
    save_archive(file, content, np.arange(8, dtype=np.float32).tobytes(), zipfile.ZIP_DEFLATED)
    np.testing.assert_array_equal(read_weights(file).arrays["a"], np.arange(8).reshape(4, 2))


def test_a_small_array_that_repeats_its_numbers_is_read(tmp_path):
    content = b"\x80\x02}" + opcodes("a") + tensor((3, 4), (0, 1)) + b"s."
    save_archive(tmp_path / "expanded.pth", content, np.arange(4, dtype=np.float32).tobytes())
    expected = np.tile(np.arange(4), (3, 1))
    np.testing.assert_array_equal(read_weights(tmp_path / "expanded.pth").arrays["a"], expected)


@pytest.mark.parametrize("name", ["a.pth", "a.safetensors"])
def test_empty_files_and_pointers_are_told(tmp_path, name):
    file = tmp_path / name
    file.write_bytes(b"")
    with pytest.raises(CheckpointError, match="is empty"):
        read_weights(file)
    file.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n")
    with pytest.raises(CheckpointError, match="git lfs pull"):
        read_weights(file)


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


@pytest.mark.parametrize(
    "prefix", ["module.", "state_dict.", "_orig_mod.", "state_dict.module.", "module._orig_mod."]
)
def test_what_wrappers_put_before_names_is_cut(prefix):
    wrapped = {prefix + name: array for name, array in resnet().items()}
    if "state_dict" in prefix:
        wrapped["optimizer.state.0.exp_avg"] = np.zeros(3, np.float32)
    arrays = unwrap(wrapped)
    assert arrays.keys() == resnet().keys()
    loaded = load(weights_of(arrays), act())
    jax.tree.map(np.testing.assert_array_equal, loaded, load(weights_of(resnet()), act()))


def test_a_compiled_part_of_a_network_keeps_its_place():
    names = {k.replace("layer1.", "layer1._orig_mod."): v for k, v in resnet().items()}
    assert unwrap(names).keys() == resnet().keys()


def test_names_of_nobody_are_left_alone():
    names = {"module.a.b": np.zeros(1), "c": np.zeros(1)}
    assert unwrap(names) == names


def test_weights_that_are_no_fractions_are_refused_by_name():
    for dtype in (np.uint16, np.complex64):
        arrays = resnet()
        arrays["layer1.0.conv1.weight"] = arrays["layer1.0.conv1.weight"].astype(dtype)
        with pytest.raises(CheckpointError, match=rf"layer1\.0\.conv1\.weight \({dtype.__name__}"):
            load(weights_of(arrays), act())


def test_half_a_batch_norm_is_told():
    arrays = resnet()
    del arrays["bn1.weight"]
    with pytest.raises(CheckpointError, match=r"missing: bn1\.frozen"):
        load(weights_of(arrays), act())


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
    weights = starting_weights(source_of(config), [config])
    record_weights(tmp_path, weights)
    record = json.loads((tmp_path / "weights.json").read_text())
    assert record == {"file": str(file), "kind": weights.kind.title, "sha256": weights.sha256}
    (tmp_path / "checkpoints/1").mkdir(parents=True)
    assert starting_weights(source_of(config), [config]) is None
