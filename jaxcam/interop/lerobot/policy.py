"""A run's policy as a LeRobot checkpoint (version 0.4.4), and a LeRobot checkpoint as a run.

Such a checkpoint is a folder: `model.safetensors`, `config.json`, and two pipelines that scale what
goes into the network and what comes out of it (`jaxcam.interop.lerobot.pipelines`). What fits,
`jaxcam.interop.lerobot.layout` knows.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxcam.config.fields import check_types, fill
from jaxcam.config.sizes import size_name
from jaxcam.config.train import TrainConfig
from jaxcam.errors import CheckpointError, ConfigError
from jaxcam.files.whole import whole
from jaxcam.interop.lerobot.counterparts import COUNTERPARTS, Counterpart, policy_file
from jaxcam.interop.lerobot.layout import config_of, settings_of, spec_of
from jaxcam.interop.lerobot.pipelines import (
    ACTION,
    BEFORE,
    IMAGE,
    SCALINGS,
    STATE,
    STATISTICS,
    image_scaling_of,
    read_stats,
    safetensors_numpy,
    write_json,
    write_pipelines,
)
from jaxcam.interop.lerobot.records import PolicyFile, read_checkpoint_json, record_of
from jaxcam.models import Params, PolicySpec, make_policy
from jaxcam.models.act.transformer import sine_table
from jaxcam.models.normalization import (
    action_deviation,
    action_range,
    proprio_deviation,
    proprio_range,
)
from jaxcam.models.policy import statistic
from jaxcam.models.weights.load import Weights, load, read_weights, record_weights, to_torch
from jaxcam.models.weights.names import MAPS
from jaxcam.models.weights.names_robot import Arrays
from jaxcam.runs.folder import RunDir
from jaxcam.runs.identity import USUAL_SPACE, resolve
from jaxcam.sim.actions import action_dim, is_delta
from jaxcam.sim.world import PROPRIO_DIM
from jaxcam.training.checkpoint import Checkpoints, PolicyInputs, rebuild_policy, records_of
from jaxcam.training.side import make_side
from jaxcam.training.state import init_state, make_optimizer

VERSION = "0.4.4"
"""LeRobot's version whose layout this is."""
ABOUT = ("task", "scene", "action_space", "rotations")
"""The settings that an export of ours tells beside LeRobot's, in `jaxcam.json`."""


@dataclass(frozen=True)
class About:
    """What `jaxcam.json` says; of what it does not, nothing is known."""

    action_space: str | None = None
    rotations: str | None = None
    task: str | None = None
    scene: str | None = None
    step: int | None = None

    completed = TrainConfig.completed

    def __post_init__(self) -> None:
        check_types(self)


DELTAS_AVERAGED = (
    "Temporal ensembling: LeRobot averages deltas as they were predicted for a step, jaxcam the "
    "absolute targets that they lead to. The same network moves in another way there than here."
)

BATCH_NORMS = (
    "Batch norms: acting is the same. Trained further, LeRobot's follow the batches, while here "
    "they stay as they are."
)


def export_policy(inputs: PolicyInputs, out: Path) -> list[str]:
    """Write a run's policy as a LeRobot checkpoint.

    Args:
        inputs: From `jaxcam.training.checkpoint.load_policy_inputs`.
        out: Folder, which must not exist.

    Returns:
        What is not the same there as it is here, in sentences.

    Raises:
        CheckpointError: LeRobot's network has no place for this policy, or `out` exists.
    """
    name = inputs.config.policy
    if name not in COUNTERPARTS or COUNTERPARTS[name].restore is None:
        known = " and ".join(n for n, one in COUNTERPARTS.items() if one.restore)
        raise CheckpointError(f"Only {known} can be exported, not {name}.")
    (settings, spec), counterpart = records_of(inputs), COUNTERPARTS[name]
    if out.exists():
        raise CheckpointError(f"{out} exists. Choose another folder, or delete it first.")
    config = config_of(settings, spec, inputs.config.ensemble)
    rebuild_policy(inputs)  # what is exported is whole
    arrays = _arrays(counterpart, settings, spec, inputs.params)
    scales = _scales(name, settings, spec, inputs.stats)
    try:
        with whole(out, folder=True) as part:
            safetensors_numpy().save_file(arrays, part / "model.safetensors")
            write_json(part / "config.json", config)
            write_pipelines(part, config, scales)
            about = {k: getattr(inputs.config, k) for k in ABOUT}
            write_json(part / "jaxcam.json", about | {"step": inputs.step})
    except OSError as error:
        raise CheckpointError(
            f"{out}: cannot be written: {error.strerror or error}. Make room and repeat."
        ) from error
    notes = []
    if inputs.config.ensemble and is_delta(inputs.config.action_space):
        notes.append(DELTAS_AVERAGED)
    if settings.compute_dtype != "float32":
        notes.append(
            f"The run computes in {settings.compute_dtype}, LeRobot in float32, so that actions "
            "differ by rounding. Weights are float32 in both places."
        )
    if getattr(settings, "norm", "") == "frozen" and name == "diffusion":
        notes.append(BATCH_NORMS)
    return notes


def _arrays(counterpart: Counterpart, settings: Any, spec: PolicySpec, params: Params) -> Arrays:
    """All arrays of their network, constants too."""
    kind = next(m for m in MAPS if m.title == counterpart.title)
    arrays = to_torch(params, kind)
    arrays = counterpart.restore(arrays) if counterpart.restore else arrays
    for name, array in arrays.items():
        if name.endswith(("img_feat_input_proj.weight", "pool.nets.weight")):
            arrays[name] = array[..., None, None]  # there a 1x1 convolution
    sides = (settings.crop,) * 2 if getattr(settings, "crop", 0) else (spec.height, spec.width)
    y, x = (np.linspace(-1, 1, -(-side // 32)) for side in sides)
    for name in [n for n in arrays if n.endswith("pool.nets.weight")]:
        grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2).astype(np.float32)
        arrays[name.replace("nets.weight", "pos_grid")] = grid
    if counterpart.prefix == "model.":
        arrays["vae_encoder_pos_enc"] = sine_table(spec.chunk + 2, settings.width)[None]
    else:  # their batch norms are not frozen there, and count what they have seen
        for norm in [n.removesuffix("running_var") for n in arrays if n.endswith("running_var")]:
            arrays[norm + "num_batches_tracked"] = np.zeros((), np.int64)
    return {counterpart.prefix + name: np.ascontiguousarray(x) for name, x in arrays.items()}


def _scales(name: str, settings: Any, spec: PolicySpec, stats: Mapping[str, np.ndarray]) -> Arrays:
    """What the pipelines scale by, as if they were the data's statistics."""
    tensors = {}
    for feature, ours in ((ACTION, "action"), (STATE, "proprio")):
        values = {k: statistic(stats, f"{ours}_{k}") for k in STATISTICS}
        if not settings.floors:
            pass  # LeRobot's own, which it scales by as they are
        elif name == "act":
            floor = settings.action_std_floor
            action, proprio = action_deviation(stats, floor), proprio_deviation(stats)
            values["std"] = (action if ours == "action" else proprio).size
        else:
            middle, half, _ = action_range(stats) if ours == "action" else proprio_range(stats)
            values |= {"min": middle - half, "max": middle + half}
        tensors |= {f"{feature}.{k}": v for k, v in values.items()}
    mean, std = (x.reshape(3, 1, 1) for x in SCALINGS[settings.image_scaling])
    for image in map(IMAGE.format, range(spec.views)):
        ends = {"min": np.zeros_like(mean), "max": np.ones_like(mean)}
        tensors |= {f"{image}.{k}": v for k, v in ({"mean": mean, "std": std} | ends).items()}
    return tensors


@dataclass(frozen=True)
class Foreign:
    """A LeRobot checkpoint in our terms.

    Attributes:
        policy: Name of our policy.
        settings: Of the policy.
        spec: Its sizes.
        stats: What it scales by.
        params: Its weights.
        weights: The file that these come from.
        ensemble: Rate of temporal ensembling, 0 is off.
        notes: What is not the same here as it is there, in sentences.
    """

    policy: str
    settings: Any
    spec: PolicySpec
    stats: Arrays
    params: Params
    weights: Weights
    ensemble: float
    notes: list[str]


def read_foreign(folder: Path, config: TrainConfig | None = None) -> Foreign:
    """Read a LeRobot checkpoint.

    Args:
        folder: Of the checkpoint.
        config: Of the run that it is to become, whose sizes it must then have.

    Raises:
        CheckpointError: It is not whole, our network has no place for it, or it does not fit the
            task.
        ConfigError: A file of its is not of the form that LeRobot writes.
    """
    described = describe_checkpoint(folder)
    theirs, spec, settings = described.theirs, described.spec, described.settings
    counterpart, stats = COUNTERPARTS[theirs.type], described.stats
    if config is not None:
        _check_fit(folder, config, spec)
    weights = read_weights(folder / "model.safetensors")
    if weights.kind is None or weights.kind.title != counterpart.title:
        title = weights.kind.title if weights.kind else "of an unknown kind"
        raise CheckpointError(
            f"{weights.path} is {title}, but its config.json is of {theirs.type}."
        )
    _check_sizes(theirs, weights)
    policy = make_policy(settings, spec, stats)
    params = load(weights, jax.eval_shape(policy.init, jax.random.key(0)))
    ensemble, notes = getattr(theirs, "temporal_ensemble_coeff", None) or 0.0, []
    images = theirs.images
    if images != [IMAGE.format(v) for v in range(spec.views)]:
        notes.append(f"Its images are taken for our views in this order: {', '.join(images)}.")
    if ensemble and (config is None or is_delta(config.action_space)):
        notes.append(DELTAS_AVERAGED)
    if not getattr(theirs, "use_group_norm", True):
        notes.append(BATCH_NORMS)
    return Foreign(theirs.type, settings, spec, stats, params, weights, ensemble, notes)


def _check_sizes(theirs: PolicyFile, weights: Weights) -> None:
    """Refuses sizes that no array has, before a network of them is laid out."""
    largest = max((size for x in weights.arrays.values() for size in x.shape), default=0)
    for names, most in ((theirs.SIZES, largest), (theirs.COUNTS, len(weights.arrays))):
        for name in names:
            value = getattr(theirs, name)
            if max(value if isinstance(value, tuple) else (value,)) > most:
                raise CheckpointError(
                    f"{weights.path.parent}: {name} is {value}, more than its weights have: it is "
                    "not the config.json of these weights."
                )


class Described(NamedTuple):
    """What stands beside a checkpoint's weights, as LeRobot says it and in our terms."""

    theirs: PolicyFile
    settings: Any
    spec: PolicySpec
    stats: Arrays


def describe_checkpoint(folder: Path) -> Described:
    """What stands beside the weights of a LeRobot checkpoint that can be made a run.

    Args:
        folder: Of the checkpoint.

    Raises:
        CheckpointError: It is not whole, or our network has no place for it.
        ConfigError: A file of its is not of the form that LeRobot writes.
    """
    theirs = read_checkpoint(folder)
    counterpart, name = COUNTERPARTS[theirs.type], theirs.type
    if counterpart.restore is None:
        raise CheckpointError(
            f"{folder} is of policy '{name}', which cannot be made a run as it is. A run can begin "
            f"with its weights: python -m jaxcam.train --policy {name} --preset lerobot "
            f"--weights {folder}"
        )
    with naming_folder(folder):
        spec = spec_of(theirs)
        settings = settings_of(theirs, image_scaling_of(folder, theirs.images))
        sizes = {STATE: spec.proprio_dim, ACTION: spec.action_dim}
        stats = read_stats(folder, counterpart.scaling, sizes)
    return Described(theirs, settings, spec, stats)


def read_checkpoint(folder: Path) -> PolicyFile:
    """The `config.json` of a checkpoint that has its pipelines.

    Args:
        folder: Of the checkpoint.

    Raises:
        CheckpointError: It is none, or of a policy or a LeRobot that is unknown here.
        ConfigError: Its file is not of the form that LeRobot writes.
    """
    content = read_checkpoint_json(folder / "config.json")
    if not (folder / f"{BEFORE}.json").exists():
        raise CheckpointError(
            f"{folder} has no {BEFORE}.json: it is from before LeRobot 0.4, or not whole. LeRobot "
            "0.4 and later migrate it: python -m lerobot.processor.migrate_policy_normalization "
            f"--pretrained-path {folder}"
        )
    with naming_folder(folder):
        return policy_file(content)


@contextmanager
def naming_folder(folder: Path) -> Iterator[None]:
    """Errors say in which folder."""
    try:
        yield
    except (CheckpointError, ConfigError) as error:
        raise type(error)(f"{folder} cannot be had here: {error}") from error


def adopt(folder: Path, config: TrainConfig) -> list[str]:
    """Make a LeRobot checkpoint a run, whose only checkpoint is of step 0.

    Args:
        folder: Of the checkpoint.
        config: Where the run is to be, its task, scene and action space; the rest is the file's.

    Returns:
        What is not the same here as it is there, in sentences.

    Raises:
        CheckpointError: It is not whole, our network has no place for it, or it does not fit the
            task; or the run's folder has checkpoints.
    """
    config = fill(config, action_space=USUAL_SPACE)
    foreign = read_foreign(folder, config)
    spec, weights = foreign.spec, foreign.weights
    named = {"policy": foreign.policy, "preset": "lerobot", "conditioning": "none"}
    size = size_name(spec.height, spec.width)
    sizes = {"views": spec.views, "resolution": size, "ensemble": foreign.ensemble}
    config = resolve(
        replace(config, **named, **sizes, weights=str(weights.path)), accelerator=False
    )
    policy = make_policy(foreign.settings, spec, foreign.stats)
    with RunDir.open(config) as run, Checkpoints(run.checkpoints) as checkpoints:
        if checkpoints.steps():
            raise CheckpointError(f"{run.path} has checkpoints. Choose another --run-dir.")
        record_weights(run.path, weights)
        optimizer = make_optimizer(config, policy.trained)
        state = init_state(lambda key: foreign.params, optimizer, jax.random.key(0))
        side = make_side(
            config,
            settings=foreign.settings,
            spec=spec,
            stats=foreign.stats,
            data={"sha256": weights.sha256},
        )
        checkpoints.save(state, side)
    return foreign.notes


def read_about(folder: Path) -> About:
    """What the `jaxcam.json` of a checkpoint says; without one nothing.

    Raises:
        ConfigError: It is not of the form that an export writes.
    """
    if not (folder / "jaxcam.json").exists():
        return About()
    with naming_folder(folder):
        return record_of(About, read_checkpoint_json(folder / "jaxcam.json"), "jaxcam.json")


def _check_fit(folder: Path, config: TrainConfig, spec: PolicySpec) -> None:
    """Refuses sizes that are not the task's."""
    for what, size, wanted in (
        ("actions of", spec.action_dim, action_dim(config.action_space)),
        ("a state of", spec.proprio_dim, PROPRIO_DIM),
    ):
        if size != wanted:
            raise CheckpointError(
                f"{folder} has {what} {size}, but {config.task} in {config.action_space} has "
                f"{wanted}."
            )
    about = read_about(folder)
    for name in ("action_space", "rotations"):
        given, wanted = getattr(about, name), getattr(config, name)
        if given not in (None, wanted):
            flag = name.replace("_", "-")
            raise CheckpointError(
                f"{folder} has {name} {given}, as its jaxcam.json says, not {wanted}: "
                f"give --{flag} {given}."
            )
