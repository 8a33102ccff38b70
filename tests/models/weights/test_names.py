"""Names of published networks and what wrappers put before them."""

import jax
import numpy as np
import pytest
from stored_weights import act, resnet, weights_of

from jaxcam.errors import CheckpointError
from jaxcam.models.weights.load import load
from jaxcam.models.weights.names import unwrap


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


def test_norms_without_statistics_have_no_place_for_them():
    with pytest.raises(CheckpointError, match="norm=frozen"):
        load(weights_of(resnet()), act(norm="identity"))
