"""Weights as others store them, and parameters of ours that they go into."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import jax
import numpy as np
from policy_inputs import make_stats, shapes

from jaxcam.models import ACT_PRESETS, PolicySpec, make_policy
from jaxcam.models.conditioning import with_conditioning
from jaxcam.models.smolvla.config import SMOLVLA_PRESETS
from jaxcam.models.weights.load import Weights
from jaxcam.models.weights.names import name_map_of


def weights_of(arrays):
    return Weights(Path("file.pth"), arrays, name_map_of(list(arrays)), "")


def resnet(d_in=3):
    """A ResNet-18 as torchvision stores it, every number random; do not write to its arrays."""
    return dict(_resnet(d_in))


@cache
def _resnet(d_in):
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


@cache
def act(conditioning="late", **changes):
    sizes = {"width": 16, "heads": 2, "hidden": 16, "layers": 1, "latent_layers": 1, "chunk": 4}
    config = with_conditioning(ACT_PRESETS["paper"], conditioning)
    config = replace(config, **({"norm": "frozen", "encoder_width": 16} | sizes | changes))
    return zeros(make_policy(config, PolicySpec(3, 5, 1, 64, 64, 4), make_stats()))


def zeros(policy):
    return jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes(policy))


@cache
def tiny_smolvla():
    spec = PolicySpec(3, 5, 1, 64, 64, 4)
    config = replace(SMOLVLA_PRESETS["tiny"], chunk=4)
    return zeros(make_policy(config, spec, make_stats()))
