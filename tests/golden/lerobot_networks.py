"""LeRobot 0.4.4's networks of ACT and Diffusion Policy, imported without what they do not use.

    pip install torch numpy einops
    pip install --no-deps lerobot==0.4.4 diffusers==0.35.2 torchvision
    pip install "huggingface_hub<1" importlib_metadata requests filelock regex pillow

The rest of LeRobot (data, processors, optimizers, configuration files) and torchvision's compiled
operators are replaced by stand-ins, so that no version of theirs has to fit.
"""

import importlib.util
import sys
import types
import zlib
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np

STAND_INS = (
    "torchvision._meta_registrations",
    "torchvision._autograd_registrations",
    "lerobot.datasets",
    "lerobot.datasets.utils",
    "lerobot.optim",
    "lerobot.optim.optimizers",
    "lerobot.optim.schedulers",
    "lerobot.processor",
)


class AnyConfig:
    """Base of LeRobot's settings: image and state features are set by hand."""

    @classmethod
    def register_subclass(cls, name: str):
        del name
        return lambda kind: kind

    def __post_init__(self) -> None:
        pass


def _module(name: str, **attributes: object) -> None:
    module = types.ModuleType(name)
    vars(module).update(attributes)
    sys.modules[name] = module


for name in STAND_INS:
    sys.modules[name] = MagicMock()
folders = importlib.util.find_spec("lerobot").submodule_search_locations
_module("lerobot.policies", __path__=[str(Path(folders[0], "policies"))])
_module("lerobot.configs", __path__=[str(Path(folders[0], "configs"))])
_module("lerobot.configs.policies", PreTrainedConfig=AnyConfig)
_module("lerobot.policies.pretrained", PreTrainedPolicy=type("PreTrainedPolicy", (), {}))

from lerobot.policies.act.modeling_act import (  # noqa: E402
    ACT,
    ACTConfig,
    ACTPolicy,
    ACTTemporalEnsembler,
)
from lerobot.policies.diffusion.modeling_diffusion import (  # noqa: E402
    DiffusionConditionalResidualBlock1d,
    DiffusionConfig,
    DiffusionModel,
)

__all__ = [
    "ACT",
    "ACTConfig",
    "ACTPolicy",
    "ACTTemporalEnsembler",
    "DiffusionConditionalResidualBlock1d",
    "DiffusionConfig",
    "DiffusionModel",
    "fill",
    "settings",
]


def settings(kind: type, state: int, action: int, views: int, size: int, **changes: object):
    """A configuration with features of these sizes."""

    class Sized(kind):
        robot_state_feature = types.SimpleNamespace(shape=(state,))
        action_feature = types.SimpleNamespace(shape=(action,))
        env_state_feature = None

    config = Sized(**changes)
    image = types.SimpleNamespace(shape=(3, size, size))
    config.image_features = {f"observation.images.{v}": image for v in range(views)}
    return config


def weight(name: str, shape: tuple[int, ...]) -> np.ndarray:
    """The array of a name: seeded by it, with a spread that keeps activations near 1."""
    values = np.random.RandomState(zlib.crc32(name.encode())).normal(size=shape)
    if name.endswith("running_var"):
        return (1 + 0.5 * np.abs(values)).astype(np.float32)
    if len(shape) > 1:
        return (values * np.sqrt(1.5 / np.prod(shape[1:]))).astype(np.float32)
    return (0.1 * values + name.endswith("weight")).astype(np.float32)


def fill(model) -> dict[str, list[int]]:
    """Give every array of a model the value its name makes, and list them with their shapes."""
    import torch

    shapes = {}
    for name, array in model.state_dict().items():
        if name.endswith(("num_batches_tracked", "pos_grid", "pos_enc", "pos_table")):
            continue
        shapes[name] = list(array.shape)
        with torch.no_grad():
            array.copy_(torch.from_numpy(weight(name, tuple(array.shape))))
    return shapes
