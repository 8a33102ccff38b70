"""A run's policy as a LeRobot checkpoint (version 0.4.4), and a LeRobot checkpoint as a run.

Such a checkpoint is a folder: `model.safetensors`, `config.json`, and two pipelines that scale what
goes into the network and what comes out of it. What fits, `jaxcam.interop.lerobot_layout` knows.
"""

import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxcam.config.train import TrainConfig
from jaxcam.errors import CheckpointError
from jaxcam.interop.lerobot_layout import (
    ACTION,
    COUNTERPARTS,
    IMAGE,
    SCALINGS,
    STATE,
    Counterpart,
    config_of,
    settings_of,
)
from jaxcam.models import FAMILIES, Params, PolicySpec, make_policy
from jaxcam.models.act.transformer import sine_table
from jaxcam.models.normalization import (
    action_deviation,
    action_range,
    proprio_deviation,
    proprio_range,
)
from jaxcam.models.weights.load import load, read_weights, record_weights, to_torch
from jaxcam.models.weights.names import MAPS
from jaxcam.models.weights.names_robot import Arrays
from jaxcam.runs.folder import RunDir
from jaxcam.runs.identity import resolve
from jaxcam.sim.actions import action_dim
from jaxcam.sim.world import PROPRIO_DIM
from jaxcam.training.checkpoint import Checkpoints, PolicyInputs
from jaxcam.training.side import make_side
from jaxcam.training.state import init_state, make_optimizer

VERSION = "0.4.4"
"""LeRobot's version whose layout this is."""
STATISTICS = ("mean", "std", "min", "max")


def export_policy(inputs: PolicyInputs, out: Path) -> None:
    """Write a run's policy as a LeRobot checkpoint.

    Args:
        inputs: From `jaxcam.training.checkpoint.load_policy_inputs`.
        out: Folder, which must not exist.

    Raises:
        CheckpointError: LeRobot's network has no place for this policy, or `out` exists.
    """
    name, spec = inputs.config.policy, PolicySpec(**inputs.spec)
    if name not in COUNTERPARTS:
        raise CheckpointError(f"Only {' and '.join(COUNTERPARTS)} can be exported, not {name}.")
    settings, counterpart = FAMILIES[name].config(**inputs.settings), COUNTERPARTS[name]
    if out.exists():
        raise CheckpointError(f"{out} exists. Choose another folder, or delete it first.")
    config = config_of(settings, spec, inputs.config.ensemble)
    arrays = _arrays(counterpart, settings, spec, inputs.params)
    scales = _scales(name, settings, spec, inputs.stats)
    part = out.with_name(out.name + ".part")
    shutil.rmtree(part, ignore_errors=True)
    try:
        part.mkdir(parents=True)
        _save(part / "model.safetensors", arrays)
        _write(part / "config.json", config)
        _write_pipelines(part, config, scales)
        about = {k: getattr(inputs.config, k) for k in ("task", "scene", "action_space")}
        _write(part / "jaxcam.json", about | {"step": inputs.step})
        os.replace(part, out)
    except OSError as error:
        raise CheckpointError(f"{part}: {error.strerror or error}. Make room, repeat.") from error


def _arrays(counterpart: Counterpart, settings: Any, spec: PolicySpec, params: Params) -> Arrays:
    """All arrays of their network, constants too."""
    kind = next(m for m in MAPS if m.title == counterpart.title)
    arrays = counterpart.restore(to_torch(params, kind))
    for name, array in arrays.items():
        if name.endswith(("img_feat_input_proj.weight", "pool.nets.weight")):
            arrays[name] = array[..., None, None]  # there a 1x1 convolution
    if counterpart.prefix == "model.":
        arrays["vae_encoder_pos_enc"] = sine_table(spec.chunk + 2, settings.width)[None]
    sides = (settings.crop,) * 2 if getattr(settings, "crop", 0) else (spec.height, spec.width)
    y, x = (np.linspace(-1, 1, -(-side // 32)) for side in sides)
    for name in [n for n in arrays if n.endswith("pool.nets.weight")]:
        grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2).astype(np.float32)
        arrays[name.replace("nets.weight", "pos_grid")] = grid
    return {counterpart.prefix + name: np.ascontiguousarray(x) for name, x in arrays.items()}


def _scales(name: str, settings: Any, spec: PolicySpec, stats: Mapping[str, np.ndarray]) -> Arrays:
    """What the pipelines scale by, as if they were the data's statistics."""
    found = {}
    for feature, ours in ((ACTION, "action"), (STATE, "proprio")):
        values = {k: np.asarray(stats[f"{ours}_{k}"], np.float32) for k in STATISTICS}
        if name == "act":
            floor = settings.action_std_floor
            action, proprio = action_deviation(stats, floor), proprio_deviation(stats)
            values["std"] = (action if ours == "action" else proprio).size
        else:
            middle, half = action_range(stats) if ours == "action" else proprio_range(stats)
            values |= {"min": middle - half, "max": middle + half}
        found |= {f"{feature}.{k}": v for k, v in values.items()}
    mean, std = (x.reshape(3, 1, 1) for x in SCALINGS[settings.image_scaling])
    for image in map(IMAGE.format, range(spec.views)):
        ends = {"min": np.zeros_like(mean), "max": np.ones_like(mean)}
        found |= {f"{image}.{k}": v for k, v in ({"mean": mean, "std": std} | ends).items()}
    return found


def _write_pipelines(folder: Path, config: dict[str, Any], arrays: Arrays) -> None:
    """What LeRobot does before and after the network."""
    device = _step("device_processor", device="cpu", float_dtype=None)
    scaled = {"eps": 1e-8, "norm_map": config["normalization_mapping"]}
    out = config["output_features"]
    pipelines = {
        "policy_preprocessor": [
            _step("rename_observations_processor", rename_map={}),
            _step("to_batch_processor"),
            device,
            _step("normalizer_processor", features=config["input_features"] | out, **scaled),
        ],
        "policy_postprocessor": [
            _step("unnormalizer_processor", features=out, **scaled),
            device,
        ],
    }
    for name, steps in pipelines.items():
        for i, step in enumerate(steps):
            if "norm_map" in step["config"]:
                step["state_file"] = f"{name}_step_{i}_{step['registry_name']}.safetensors"
                _save(folder / step["state_file"], arrays)
        _write(folder / f"{name}.json", {"name": name, "steps": steps})


def _step(name: str, **config: Any) -> dict[str, Any]:
    return {"registry_name": name, "config": config}


def _save(path: Path, arrays: Arrays) -> None:
    _safetensors().save_file(arrays, path)


def _safetensors() -> Any:
    try:
        import safetensors.numpy
    except ImportError as error:
        raise CheckpointError(
            "LeRobot's checkpoints need the package safetensors: pip install 'jaxcam[smolvla]'"
        ) from error
    return safetensors.numpy


def _write(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=2) + "\n")


def adopt(folder: Path, config: TrainConfig) -> None:
    """Make a LeRobot checkpoint a run, whose only checkpoint is of step 0.

    Args:
        folder: Of the checkpoint.
        config: Where the run is to be, its task, scene and action space; the rest is the file's.

    Raises:
        CheckpointError: It is not whole, our network has no place for it, or it does not fit the
            task; or the run's folder has checkpoints.
    """
    theirs = _read_json(folder / "config.json")
    scales = _read_scales(folder)
    images = [k for k, f in theirs.get("input_features", {}).items() if f["type"] == "VISUAL"]
    try:
        settings, spec = settings_of(theirs, _image_scaling(scales, images))
    except (CheckpointError, KeyError) as error:
        raise CheckpointError(f"{folder} cannot be had here: {error}") from error
    _check_fit(folder, config, spec)
    stats = {
        f"{ours}_{k}": scales[f"{feature}.{k}"]
        for feature, ours in ((ACTION, "action"), (STATE, "proprio"))
        for k in STATISTICS
    }
    file = folder / "model.safetensors"
    policy = make_policy(settings, spec, stats)
    weights = read_weights(file)
    params = load(weights, jax.eval_shape(policy.init, jax.random.key(0)))
    ensemble = theirs.get("temporal_ensemble_coeff") or 0.0
    named = {"policy": theirs["type"], "preset": "lerobot", "conditioning": "none"}
    sizes = {"views": spec.views, "resolution": spec.height, "ensemble": ensemble}
    config = resolve(replace(config, **named, **sizes, weights=str(file)), accelerator=False)
    with RunDir.open(config) as run, Checkpoints(run.checkpoints) as checkpoints:
        if checkpoints.steps():
            raise CheckpointError(f"{run.path} has checkpoints. Choose another --run-dir.")
        record_weights(run.path, weights)
        optimizer = make_optimizer(config, policy.trained)
        state = init_state(lambda key: params, optimizer, jax.random.key(0))
        side = make_side(
            config, settings=settings, spec=spec, stats=stats, data={"sha256": weights.sha256}
        )
        checkpoints.save(state, side)


def _check_fit(folder: Path, config: TrainConfig, spec: PolicySpec) -> None:
    """Refuses sizes that are not the task's."""
    for what, found, wanted in (
        ("actions of", spec.action_dim, action_dim(config.action_space)),
        ("a state of", spec.proprio_dim, PROPRIO_DIM),
        ("images as high as wide:", spec.height, spec.width),
    ):
        if found != wanted:
            raise CheckpointError(
                f"{folder} has {what} {found}, but {config.task} in {config.action_space} has "
                f"{wanted}."
            )


def _read_json(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise CheckpointError(f"{path.parent} is no LeRobot checkpoint: it has no {path.name}.")
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise CheckpointError(f"{path.parent} is no LeRobot checkpoint: {error}.") from error


def _read_scales(folder: Path) -> Arrays:
    """The statistics that its first pipeline scales by."""
    steps = _read_json(folder / "policy_preprocessor.json")["steps"]
    file = next((s["state_file"] for s in steps if "normal" in s.get("state_file", "")), "")
    if Path(file).name != file or not (folder / file).is_file():
        raise CheckpointError(f"{folder} has no file of statistics '{file}'.")
    return _safetensors().load_file(folder / file)


def _image_scaling(scales: Arrays, images: list[str]) -> str:
    """Our name for the way all its images are scaled."""
    for name, (mean, std) in SCALINGS.items():
        wanted = np.stack([mean, std])
        found = [[scales[f"{image}.{k}"].ravel() for k in ("mean", "std")] for image in images]
        if all(np.allclose(pair, wanted, atol=1e-6) for pair in found):
            return name
    raise CheckpointError(
        "It scales images by means and deviations of their own. Those of ImageNet (LeRobot's "
        "default), 0.5 and 0.5, or 0 and 1 can be had here."
    )
