"""What LeRobot does to numbers before and after the network, written and read.

Two pipelines stand beside a policy, and they are what LeRobot obeys: what `config.json` says of
normalisation nobody reads once they are there. Of each kind of feature the pipeline names a mode,
and a feature without statistics is left as it is.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from jaxcam.config.fields import short
from jaxcam.errors import CheckpointError
from jaxcam.interop.lerobot.records import (
    Mode,
    SmolVlaFile,
    features,
    read_checkpoint_json,
    record_of,
)
from jaxcam.models.fusion import IMAGENET_MEAN, IMAGENET_STD
from jaxcam.models.normalization import LEROBOT_STD_FLOOR
from jaxcam.models.smolvla.config import MOST_TOKENS
from jaxcam.models.weights.load import check_head, read_weights
from jaxcam.models.weights.names_robot import Arrays

STATE, ACTION, IMAGE = "observation.state", "action", "observation.images.view_{}"
BEFORE, AFTER = "policy_preprocessor", "policy_postprocessor"
STATISTICS = ("mean", "std", "min", "max")
SCALINGS = {
    "imagenet": (IMAGENET_MEAN, IMAGENET_STD),
    "symmetric": (np.full(3, 0.5, np.float32), np.full(3, 0.5, np.float32)),
    "unit": (np.zeros(3, np.float32), np.ones(3, np.float32)),
}
"""Mean and deviation of colours in 0 to 1, by the name of our scaling."""
BYTES = 256 * 2**20
"""Most of a file of statistics."""


@dataclass(frozen=True)
class Pipeline:
    """A pipeline's file."""

    steps: list[Any]
    name: str = ""


@dataclass(frozen=True)
class Step:
    """One step in it; a class is named where a step has no name of its own."""

    registry_name: str | None = None
    class_name: str | None = None
    config: dict[str, Any] | None = None
    state_file: str | None = None


@dataclass(frozen=True)
class Normalizer:
    """Settings of the step that scales."""

    features: dict[str, Any]
    norm_map: dict[str, Mode]
    eps: float = LEROBOT_STD_FLOOR
    normalize_observation_keys: list[str] | None = None
    stats: dict[str, Any] | None = None
    device: str | None = None
    dtype: str | None = None


@dataclass(frozen=True)
class Renaming:
    """Settings of the step that gives observations other names."""

    rename_map: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Nothing:
    """Of a step without settings."""


@dataclass(frozen=True)
class DeviceStep:
    """Settings of the step that moves arrays."""

    device: str | None = None
    float_dtype: str | None = None


@dataclass(frozen=True)
class Tokenizer:
    """Settings of the step that makes tokens of the task's words."""

    max_length: int
    task_key: str = "task"
    padding_side: str = "right"
    padding: str = "max_length"
    truncation: bool = True
    tokenizer_name: str | None = None


STEPS: dict[str, tuple[type, dict[str, tuple[Any, ...]]]] = {
    "rename_observations_processor": (Renaming, {"rename_map": ({},)}),
    "to_batch_processor": (Nothing, {}),
    "device_processor": (DeviceStep, {"float_dtype": (None, "float32")}),
}
"""Steps that leave numbers alone as long as the settings that are named have one of these values;
others may have any."""
WORDS: dict[str, tuple[type, dict[str, tuple[Any, ...]]]] = {
    "smolvla_new_line_processor": (Nothing, {}),
    "tokenizer_processor": (
        Tokenizer,
        {
            "max_length": tuple(range(MOST_TOKENS, 4097)),  # ours are at most as long
            "task_key": ("task",),
            "padding_side": ("right",),
            "tokenizer_name": (None, SmolVlaFile.vlm_model_name),
        },
    ),
}
"""Steps of a policy that reads words, in the same way."""
_SCALES = (
    Normalizer,
    {
        "eps": (LEROBOT_STD_FLOOR,),
        "normalize_observation_keys": (None,),
        "stats": (None, {}),
        "dtype": (None, "float32"),
    },
)
"""The step that scales, in the same way."""


@dataclass(frozen=True)
class Scaling:
    """The step of a pipeline that scales.

    Attributes:
        modes: By kind of feature.
        kinds: Of the features that it scales.
        arrays: Statistics, as `<feature>.<statistic>`.
    """

    modes: Mapping[str, str]
    kinds: Mapping[str, str]
    arrays: Arrays

    def mode(self, feature: str) -> str:
        """How it scales a feature; actions need not be listed."""
        kind = "ACTION" if feature == ACTION else self.kinds.get(feature, "")
        if kind == "ACTION" and feature != ACTION:
            return "IDENTITY"  # as LeRobot passes it over
        has_any = any(name.rpartition(".")[0] == feature for name in self.arrays)
        return self.modes.get(kind, "IDENTITY") if has_any else "IDENTITY"

    def pair(self, feature: str, size: int, *names: str) -> list[np.ndarray]:
        """Two statistics of a feature, float32 [size] each."""
        pair = []
        for name in (f"{feature}.{statistic}" for statistic in names):
            if name not in self.arrays:
                raise CheckpointError(f"It scales {feature} by '{name}', which it does not have.")
            array = self.arrays[name].ravel()
            if np.iscomplexobj(array):
                raise CheckpointError(f"'{name}' are complex numbers.")
            array = array.astype(np.float32)
            if array.size != size or not np.isfinite(array).all():
                raise CheckpointError(f"'{name}' are not {size} finite numbers: {array[:8]}.")
            pair.append(array)
        return pair


def read_scaling(folder: Path, name: str) -> Scaling:
    """The step that scales of a pipeline.

    Args:
        folder: Of the checkpoint.
        name: `BEFORE` or `AFTER`.

    Raises:
        CheckpointError: It has none or several, or a step that changes numbers in another way.
        ConfigError: The file is not of the form that LeRobot writes.
    """
    path = folder / f"{name}.json"
    scales = "normalizer_processor" if name == BEFORE else "unnormalizer_processor"
    known = STEPS | WORDS | {scales: _SCALES}
    scaling: list[tuple[Step, Any]] = []
    for listed in record_of(Pipeline, read_checkpoint_json(path), str(path)).steps:
        if isinstance(listed, dict):
            listed = {"class_name" if k == "class" else k: v for k, v in listed.items()}
        step = record_of(Step, listed, f"a step of {path}")
        kind = step.registry_name or step.class_name or ""
        if kind not in known:
            raise CheckpointError(f"{path} has the step {kind!r:.80}, which has no place here.")
        record, allowed = known[kind]
        settings = record_of(record, step.config or {}, f"{path}: step '{kind}'")
        for key, values in allowed.items():
            if (value := getattr(settings, key)) not in values:
                raise CheckpointError(
                    f"{path}: {key} of '{kind}' is {short(value)}, which has no place here."
                )
        scaling += [(step, settings)] if kind == scales else []
    if len(scaling) != 1:
        raise CheckpointError(f"{path} has {len(scaling)} steps '{scales}', not one.")
    [(step, settings)] = scaling
    listed = features(settings.features, f"the features of {path}")
    kinds = {key: feature.type for key, feature in listed.items()}
    return Scaling(settings.norm_map, kinds, _state(folder, step.state_file))


def _state(folder: Path, name: str | None) -> Arrays:
    """The statistics that a step has in a file of its own."""
    if not name:
        return {}
    file = folder / name
    if name not in os.listdir(folder) or not file.is_file():
        raise CheckpointError(f"{folder} has no file of statistics {name!r:.80}.")
    if (size := file.stat().st_size) > BYTES:
        raise CheckpointError(f"{file} has {size} bytes, too many for statistics.")
    check_head(file)
    return read_weights(file).arrays


def read_stats(folder: Path, wanted: Mapping[str, str], sizes: Mapping[str, int]) -> Arrays:
    """Our statistics, to be taken without floors, that scale as a checkpoint's pipelines do.

    Args:
        folder: Of the checkpoint.
        wanted: Mode of our policy by kind of feature.
        sizes: Numbers of `STATE` and `ACTION`.

    Raises:
        CheckpointError: They scale in another way than our policy can.
    """
    before, after = read_scaling(folder, BEFORE), read_scaling(folder, AFTER)
    for name in sorted(before.arrays.keys() & after.arrays.keys()):
        alike = np.array_equal(before.arrays[name], after.arrays[name])
        if name.startswith(f"{ACTION}.") and not alike:
            raise CheckpointError(f"Its two pipelines have different numbers for '{name}'.")
    if before.mode(ACTION) != after.mode(ACTION) and before.mode(ACTION) != "IDENTITY":
        raise CheckpointError(
            f"Its pipelines scale actions by {before.mode(ACTION)} and by {after.mode(ACTION)}."
        )
    stats = {}
    for feature, kind, ours, scaling in (
        (STATE, "STATE", "proprio", before),
        (ACTION, "ACTION", "action", after),
    ):
        mode = scaling.mode(feature)
        if mode not in ("IDENTITY", wanted[kind]):
            raise CheckpointError(f"It scales {feature} by {mode}, our policy by {wanted[kind]}.")
        first, second = _two(scaling, feature, sizes[feature], mode, wanted[kind])
        if wanted[kind] == "MEAN_STD":
            values = (first, second, first - second, first + second)
        else:
            values = ((first + second) / 2, (second - first) / 2, first, second)
        stats |= {f"{ours}_{k}": v for k, v in zip(STATISTICS, values, strict=True)}
    return stats


def _two(scaling: Scaling, feature: str, size: int, mode: str, wanted: str) -> list[np.ndarray]:
    """Mean and deviation, or both ends of the range, of one feature."""
    one = np.ones(size, np.float32)
    if mode == "IDENTITY":
        return [0 * one if wanted == "MEAN_STD" else -one, one]
    names = STATISTICS[:2] if wanted == "MEAN_STD" else STATISTICS[2:]
    return scaling.pair(feature, size, *names)


def image_scaling_of(folder: Path, images: list[str]) -> str:
    """Our name for the way a checkpoint's images are scaled.

    Args:
        folder: Of the checkpoint.
        images: Its features that are images.

    Raises:
        CheckpointError: We have none.
    """
    scaling = read_scaling(folder, BEFORE)
    ways = []
    for image in images:
        mode = scaling.mode(image)
        if mode == "IDENTITY":
            mean, std = SCALINGS["unit"]
        elif mode == "MEAN_STD":
            mean, std = scaling.pair(image, 3, "mean", "std")
        elif mode == "MIN_MAX":
            low, high = scaling.pair(image, 3, "min", "max")
            mean, std = (low + high) / 2, (high - low) / 2
        else:
            raise CheckpointError(f"It scales {image} by {mode}, which cannot be had here.")
        ways.append(np.stack([mean, std]))
    for name, pair in SCALINGS.items():
        if all(np.allclose(way, np.stack(pair), atol=1e-6) for way in ways):
            return name
    raise CheckpointError(
        "It scales images by means and deviations of their own. Those of ImageNet (LeRobot's "
        "default), 0.5 and 0.5, or 0 and 1 can be had here."
    )


def write_pipelines(folder: Path, config: Mapping[str, Any], arrays: Arrays) -> None:
    """Write what LeRobot does before and after the network.

    Args:
        folder: Of the checkpoint.
        config: Its `config.json`.
        arrays: Statistics, as `<feature>.<statistic>`.
    """
    device = _step("device_processor", device="cpu", float_dtype=None)
    scaled = {"eps": LEROBOT_STD_FLOOR, "norm_map": config["normalization_mapping"]}
    out = config["output_features"]
    pipelines = {
        BEFORE: [
            _step("rename_observations_processor", rename_map={}),
            _step("to_batch_processor"),
            device,
            _step("normalizer_processor", features=config["input_features"] | out, **scaled),
        ],
        AFTER: [
            _step("unnormalizer_processor", features=out, **scaled),
            device,
        ],
    }
    for name, steps in pipelines.items():
        for i, step in enumerate(steps):
            if "norm_map" in step["config"]:
                step["state_file"] = f"{name}_step_{i}_{step['registry_name']}.safetensors"
                safetensors_numpy().save_file(arrays, folder / step["state_file"])
        write_json(folder / f"{name}.json", {"name": name, "steps": steps})


def _step(name: str, **config: Any) -> dict[str, Any]:
    return {"registry_name": name, "config": config}


def safetensors_numpy() -> Any:
    """The package that reads and writes such files, an optional extra."""
    try:
        import safetensors.numpy
    except ImportError as error:
        raise CheckpointError(
            "LeRobot's checkpoints need the package safetensors: pip install 'jaxcam[smolvla]'"
        ) from error
    return safetensors.numpy


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write readable JSON."""
    path.write_text(json.dumps(content, indent=2) + "\n")
