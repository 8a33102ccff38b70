"""Names of LeRobot's SmolVLA."""

import jax
import numpy as np
import pytest
from stored_weights import tiny_smolvla, weights_of

from jaxcam.errors import CheckpointError
from jaxcam.models.weights.load import load
from jaxcam.models.weights.names import MAPS

SMOLVLA = {m.title: m for m in MAPS}["SmolVLA (LeRobot)"]


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
