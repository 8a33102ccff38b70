"""What LeRobot does to numbers before and after the network, written and read.

Two pipelines stand beside a policy, and they are what LeRobot obeys: what `config.json` says of
normalisation nobody reads once they are there. Of each kind of feature the pipeline names a mode,
and a feature without statistics is left as it is.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxcam.config.fields import as_record, check_value, short
from jaxcam.errors import CheckpointError
from jaxcam.files.paths import read_text
from jaxcam.models.fusion import IMAGENET_MEAN, IMAGENET_STD
from jaxcam.models.normalization import LEROBOT_STD_FLOOR
from jaxcam.models.weights.load import read_weights
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
_HARMLESS = {
    "rename_observations_processor": {"rename_map": ({},)},
    "to_batch_processor": {},
    "device_processor": {"device": None, "float_dtype": (None, "float32")},
}
"""Steps that leave numbers alone as long as their settings are among those named; None is any."""
_SCALING = {
    "eps": (LEROBOT_STD_FLOOR,),
    "features": None,
    "norm_map": None,
    "normalize_observation_keys": (None,),
    "stats": (None, {}),
    "device": None,
    "dtype": (None, "float32"),
}
"""Settings of the step that scales, in the same way."""


@dataclass(frozen=True)
class Feature:
    """What LeRobot's files say of an input or an output.

    Attributes:
        type: "VISUAL", "STATE", "ACTION" or another.
        shape: Of its array.
    """

    type: str
    shape: list[int]


@dataclass(frozen=True)
class _Step:
    """A step of a pipeline, as far as its form goes."""

    name: str
    config: dict[str, Any]
    state_file: str | None


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
        has_any = any(name.rpartition(".")[0] == feature for name in self.arrays)
        return self.modes.get(kind, "IDENTITY") if has_any else "IDENTITY"

    def pair(self, feature: str, size: int, *names: str) -> list[np.ndarray]:
        """Two statistics of a feature, float32 [size] each."""
        pair = []
        for name in (f"{feature}.{statistic}" for statistic in names):
            if name not in self.arrays:
                raise CheckpointError(f"It scales {feature} by '{name}', which it does not have.")
            array = np.asarray(self.arrays[name], np.float32).ravel()
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
    """
    path = folder / f"{name}.json"
    wanted = "normalizer_processor" if name == BEFORE else "unnormalizer_processor"
    scaling: list[_Step] = []
    for step in _steps(path):
        if step.name == wanted:
            scaling.append(step)
        elif step.name not in _HARMLESS:
            raise CheckpointError(f"{path} has the step '{step.name}', which has no place here.")
        known = _SCALING if step.name == wanted else _HARMLESS[step.name]
        for key, value in step.config.items():
            allowed = known.get(key, ())
            if allowed is not None and value not in allowed:
                raise CheckpointError(
                    f"{path}: {key} of '{step.name}' is {short(value)}, which has no place here."
                )
    if len(scaling) != 1:
        raise CheckpointError(f"{path} has {len(scaling)} steps '{wanted}', not one.")
    settings, file = scaling[0].config, scaling[0].state_file
    if file and file not in {path.name for path in folder.iterdir() if path.is_file()}:
        raise CheckpointError(f"{folder} has no file of statistics {short(file)}.")
    kinds = {k: feature.type for k, feature in features_of(path, settings, "features").items()}
    modes = settings.get("norm_map", {})
    check_value(f"{path}: ", "norm_map", modes, dict[str, str])
    return Scaling(modes, kinds, read_weights(folder / file).arrays if file else {})


def _steps(path: Path) -> list[_Step]:
    """The steps of a pipeline's file."""
    steps = read_json(path).get("steps", [])
    check_value(f"{path}: ", "steps", steps, list[dict[str, Any]])
    return [
        as_record(
            _Step,
            {
                "name": step.get("registry_name", step.get("class")),
                "config": step.get("config") or {},
                "state_file": step.get("state_file"),
            },
            f"{path}, step {number}",
        )
        for number, step in enumerate(steps)
    ]


def features_of(path: Path, content: Mapping[str, Any], name: str) -> dict[str, Feature]:
    """The features that an entry of a file lists; none if there is none.

    Args:
        path: Of the file, for messages.
        content: What has the entry.
        name: Of the entry.

    Raises:
        ConfigError: It is none of features.
    """
    listed = content.get(name) or {}
    check_value(f"{path}: ", name, listed, dict[str, dict[str, Any]])
    return {k: as_record(Feature, about, f"{path}, {k}") for k, about in listed.items()}


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


def read_json(path: Path) -> dict[str, Any]:
    """What a JSON file of a checkpoint says.

    Raises:
        CheckpointError: There is no such file, or it holds anything else.
    """
    if not path.is_file():
        raise CheckpointError(f"{path.parent} is no LeRobot checkpoint: it has no {path.name}.")
    try:
        content = json.loads(read_text(path))
    except (OSError, ValueError, RecursionError) as error:
        raise CheckpointError(f"{path.parent} is no LeRobot checkpoint: {error}.") from error
    if not isinstance(content, dict):
        raise CheckpointError(f"{path.parent} is no LeRobot checkpoint: {path.name} is no object.")
    return content
