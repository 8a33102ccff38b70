"""Every setting of every command: frozen records, their presets, their JSON form and their flags.

A setting declared as `FromPreset[T]` may be left out; `resolve` fills it from the preset of the
policy. Attribute docstrings are what `--help` prints. Nothing here imports JAX, so help is fast.
"""

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

import tyro

from jaxcam.errors import ConfigError
from jaxcam.fields import (
    PRESET,
    FromPreset,
    check_least,
    check_names,
    check_types,
    default,
    one_of,
    overrides,
)
from jaxcam.presets import PRESETS, USUAL

C = TypeVar("C", "TrainConfig", "CollectConfig", "RobomimicConfig")

# Settings that leave every update of a run as it was; all others are part of a run's identity.
FREE_TO_CHANGE = frozenset({
    "pairs", "engine", "ensemble", "data_dir", "dataset", "run_dir", "log_every", "eval_every",
    "save_every", "keep", "videos", "seeds", "log", "distributed",
})  # fmt: skip


@dataclass(frozen=True)
class TrainConfig:
    """Train a policy, evaluate it on camera poses it never saw, and write a report.

    Missing demonstrations are collected first. The same command run again resumes.
    """

    task: Annotated[str, one_of("task")] = "lift"
    """What the robot has to do."""
    scene: Annotated[str, one_of("scene")] = "randomized"
    """Whether robot and table stand still or move from episode to episode."""
    policy: Annotated[str, one_of("policy")] = "act"
    """The kind of policy."""
    preset: Annotated[str, one_of("preset")] = "auto"
    """Where unset values come from; auto is paper on an accelerator and laptop without one."""
    conditioning: Annotated[FromPreset[str], one_of("conditioning")] = PRESET
    """How the policy is told where its cameras are."""
    action_space: Annotated[str, one_of("action_space")] = "eef_delta"
    """What the policy's actions mean."""
    views: Annotated[FromPreset[int], default("the task's")] = PRESET
    """Cameras the policy sees at once."""
    seed: int = 0
    """Seed of the weights, the order of the data, the crops and the dropout."""
    seeds: Annotated[tuple[int, ...], default("--seed alone")] = ()
    """Train these seeds side by side in one program, each as a run of its own."""

    steps: FromPreset[int] = PRESET
    """Updates in all."""
    batch: FromPreset[int] = PRESET
    """Samples an update."""
    accumulate: int = 1
    """Parts that a batch's gradient is summed over, where the whole does not fit into memory."""
    lr: FromPreset[float] = PRESET
    """Learning rate at its peak."""
    schedule: Annotated[FromPreset[str], one_of("schedule")] = PRESET
    """Course of the learning rate after the warm-up."""
    warmup: FromPreset[int] = PRESET
    """Updates over which the learning rate rises to its peak."""
    final_lr: FromPreset[float] = PRESET
    """Learning rate at the end of a cosine."""
    optimizer: Annotated[FromPreset[str], one_of("optimizer")] = PRESET
    """Whether the weight decay stands beside Adam's update (adamw) or in the gradient (adam)."""
    weight_decay: FromPreset[float] = PRESET
    """Weight decay."""
    beta1: FromPreset[float] = PRESET
    """Decay of Adam's average of gradients."""
    beta2: FromPreset[float] = PRESET
    """Decay of Adam's average of squared gradients."""
    clip_norm: FromPreset[float] = PRESET
    """Largest global norm of a gradient; 0 is off."""
    ema: FromPreset[float] = PRESET
    """Largest decay of the weights' moving average, which is then evaluated; 0 is off."""
    ema_power: FromPreset[float] = PRESET
    """The decay rises as 1 - update^-power up to that; 0 has it there from the start."""
    precision: Annotated[FromPreset[str], one_of("precision")] = PRESET
    """Arithmetic of the networks; weights and rays are always float32."""
    resolution: FromPreset[int] = PRESET
    """Image side in pixels."""
    crop_min: FromPreset[float] = PRESET
    """Smallest side of a random crop as a share of the image; 1 is off."""
    model: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE ...")] = ()
    """Changes to the policy's network as name=value, for example width=256."""
    weights: str = ""
    """File of weights to start from: those of an image encoder or of a whole policy. What a file
    is, `python -m jaxcam.weights FILE` tells."""
    stem: Annotated[str, one_of("stem")] = "keep"
    """A first convolution that also takes the ray-map keeps the weights' kernel for colours, or
    starts anew, as the authors' does."""

    n: Annotated[FromPreset[int], default("the task's")] = PRESET
    """Cameras a demonstration is seen from."""
    m: Annotated[FromPreset[int], default("the task's")] = PRESET
    """Cameras by which that window moves from one demonstration to the next."""
    demos: int = 200
    """Training demonstrations."""
    validation: int = 10
    """Validation demonstrations."""
    pairs: int = 50
    """Held-out (initial state, camera pose) pairs of the final evaluation."""
    engine: Annotated[str, one_of("engine")] = "auto"
    """Physics of the final evaluation; auto is mjx-warp on an accelerator and native without, and
    for the tasks of ManiSkill sapien-gpu on an NVIDIA card and sapien without."""
    ensemble: float = 0.0
    """Rate of temporal ensembling in the final evaluation, such as ACT's 0.01: the policy is asked
    at every step, and all that it ever predicted for a step is averaged; 0 is off."""

    videos: int = 16
    """Rollouts shown in each of two videos of the final evaluation, of the first pairs and of
    failures; 0 is none."""

    data_dir: str = "data"
    """Folder of the datasets."""
    dataset: Annotated[str, default("collected")] = ""
    """Dataset file to train on, for example an imported one; it brings demos, validation, n, m."""
    run_dir: Annotated[FromPreset[str], default("runs/TASK-SCENE-POLICY-...-SEED")] = PRESET
    """Folder of the run."""
    log_every: FromPreset[int] = PRESET
    """Updates between rows of metrics."""
    eval_every: FromPreset[int] = PRESET
    """Updates between looks at the validation demonstrations."""
    save_every: FromPreset[int] = PRESET
    """Updates between checkpoints."""
    keep: int = 10
    """Newest checkpoints that are kept."""
    steps_per_call: FromPreset[int] = PRESET
    """Updates in one compiled call. Part of the run's identity: it moves the last digits."""
    log: Annotated[tuple[str, ...], one_of("log")] = ()
    """Where metrics go besides metrics.jsonl."""
    distributed: bool = False
    """Be one of several processes of one run: on Slurm, Open MPI or Kubernetes they find each
    other; elsewhere JAX_COORDINATOR_ADDRESS, JAX_NUM_PROCESSES and JAX_PROCESS_ID are read."""

    def __post_init__(self) -> None:
        check_types(self)
        check_names(self)
        check_least(self, 1, "views steps batch n demos pairs keep log_every eval_every")
        check_least(self, 1, "save_every steps_per_call accumulate")
        check_least(self, 0, "seed warmup weight_decay m validation ema ema_power clip_norm")
        check_least(self, 0, "final_lr beta1 beta2 videos")
        check_least(self, 16, "resolution")
        check_least(self, 0, "lr crop_min", or_equal=False)
        check_least(self, -1, "ensemble")
        _check_train(self)
        overrides(self.model)


@dataclass(frozen=True)
class CollectConfig:
    """Collect demonstrations of the scripted expert: states, commands and camera poses."""

    task: Annotated[str, one_of("task")] = "lift"
    """What the robot has to do."""
    scene: Annotated[str, one_of("scene")] = "randomized"
    """Whether robot and table stand still or move from episode to episode."""
    demos: int = 200
    """Training demonstrations."""
    validation: int = 10
    """Validation demonstrations."""
    n: Annotated[FromPreset[int], default("the task's")] = PRESET
    """Cameras a demonstration is seen from."""
    m: Annotated[FromPreset[int], default("the task's")] = PRESET
    """Cameras by which that window moves from one demonstration to the next."""
    seed: int = 0
    """Seed of the initial states and of the expert."""
    data_dir: str = "data"
    """Folder of the datasets."""

    def __post_init__(self) -> None:
        check_types(self)
        check_names(self)
        check_least(self, 1, "demos n")
        check_least(self, 0, "validation m seed")
        _check_window(self.n, self.m)


@dataclass(frozen=True)
class ReplayConfig:
    """Replay demonstrations in each action space and count how many succeed."""

    dataset: tyro.conf.Positional[str]
    """HDF5 file of demonstrations; one of ManiSkill's is imported first (`jaxcam.maniskill`)."""
    action_space: Annotated[tuple[str, ...], one_of("action_space")] = ()
    """Action spaces to replay in; the paper's four unless given."""
    engine: Annotated[str, one_of("engine")] = "auto"
    """What steps the physics."""

    def __post_init__(self) -> None:
        check_types(self)
        check_names(self)


@dataclass(frozen=True)
class ImportConfig:
    """Import demonstrations of others by their states."""

    file: tyro.conf.Positional[str]
    """File to import."""
    out: Annotated[
        str | None, tyro.conf.arg(metavar="STR"), default("data/TASK-SCENE-FILE.hdf5")
    ] = None
    """Dataset to write; train on it with `python -m jaxcam.train --dataset`."""
    scene: Annotated[str, one_of("scene")] = "randomized"
    """Whether the table and the room that are seen stand still or move from episode to episode."""
    validation: Annotated[
        int | None, tyro.conf.arg(metavar="INT"), default("every tenth, or as the file says")
    ] = None
    """Validation demonstrations, the last ones."""
    n: Annotated[FromPreset[int], default("the task's")] = PRESET
    """Cameras a demonstration is seen from."""
    m: Annotated[FromPreset[int], default("the task's")] = PRESET
    """Cameras by which that window moves from one demonstration to the next."""

    def __post_init__(self) -> None:
        check_types(self)
        check_names(self)
        check_least(self, 1, "n")
        check_least(self, 0, "validation m")
        _check_window(self.n, self.m)


@dataclass(frozen=True)
class RobomimicConfig(ImportConfig):
    """Import robomimic's demonstrations of robosuite, an HDF5 file, by replaying their states."""

    task: Annotated[str, one_of("task")] = "lift"
    """What the robot has to do."""
    actions: Annotated[str, one_of("actions")] = "commands"
    """Where commands come from: the file's own OSC_POSE actions, or the poses that its states
    reach, which every file has."""
    filter_key: Annotated[str | None, tyro.conf.arg(metavar="STR"), default("every one")] = None
    """Import only the demonstrations of this entry of the file's `mask`."""


@dataclass(frozen=True)
class ManiskillConfig(ImportConfig):
    """Import ManiSkill's trajectories, HDF5 with JSON beside it, and replay them in each space."""


@dataclass(frozen=True)
class LerobotConfig:
    """Export a dataset in LeRobot's v3 format: Parquet, MP4 and metadata with the cameras."""

    dataset: tyro.conf.Positional[str]
    """HDF5 file of demonstrations."""
    out: tyro.conf.Positional[str]
    """Folder to write."""
    resolution: int = 256
    """Image side in pixels, an even number; 84 shares the laptop preset's pictures."""
    action_space: Annotated[str, one_of("action_space")] = TrainConfig.action_space
    """What the actions mean."""
    instruction: Annotated[str | None, tyro.conf.arg(metavar="STR"), default("the task")] = None
    """The task in words, for policies that read."""
    validation: bool = False
    """Export the validation demonstrations, seen by one held-out camera each."""

    def __post_init__(self) -> None:
        check_types(self)
        check_names(self)
        check_least(self, 16, "resolution")
        if self.resolution % 2:
            raise ConfigError(f"resolution must be even for video, got {self.resolution}.")


def with_task(config: C) -> C:
    """The config with the cameras of its task where they are unset: views, n and m."""
    from jaxcam.sim import make_task

    task = make_task(config.task)
    values = {"views": task.views, "n": task.stair[0], "m": task.stair[1]}
    unset = {k: v for k, v in values.items() if getattr(config, k, 0) is None}
    return dataclasses.replace(config, **unset)


def resolve(config: TrainConfig, *, accelerator: bool | None = None) -> TrainConfig:
    """Give every unset value its preset's; a resolved config comes back as it is.

    Args:
        config: Settings, some of them perhaps unset.
        accelerator: Whether there is a GPU or TPU; None asks JAX.

    Returns:
        Settings without a `None`. Steps per call divide every interval of the run.
    """
    if all(getattr(config, f.name) is not None for f in dataclasses.fields(config)):
        return config
    config = with_task(config)
    if accelerator is None:
        import jax

        accelerator = jax.default_backend() != "cpu"
    preset = config.preset
    if preset == "auto":
        preset = "paper" if accelerator else "laptop"
    if (config.policy, preset) not in PRESETS:
        known = ", ".join(name for policy, name in PRESETS if policy == config.policy)
        raise ConfigError(f"{config.policy} has no preset '{preset}', only {known}.")
    values = {**USUAL, **PRESETS[config.policy, preset], "preset": preset}
    if not accelerator:
        values["steps_per_call"] = 1  # XLA's CPU loops run convolutions many times slower.
    given = {k: v for k, v in dataclasses.asdict(config).items() if v is not None}
    values |= {k: v for k, v in given.items() if k != "preset"}
    if config.warmup is None:
        values["warmup"] = min(values["warmup"], values["steps"] // 10)
    if config.steps_per_call is None:
        intervals = (values[k] for k in ("steps", "log_every", "eval_every", "save_every"))
        values["steps_per_call"] = math.gcd(values["steps_per_call"], *intervals)
    if config.run_dir is None:
        values["run_dir"] = _run_dir(values)
    return TrainConfig(**values)


def _run_dir(values: dict[str, Any]) -> str:
    """A folder's name: what runs are usually compared by, then what is not the task's default."""
    parts = [values[k] for k in ("task", "scene", "policy", "preset", "conditioning")]
    usual = with_task(TrainConfig(task=values["task"]))
    if values["action_space"] != usual.action_space:
        parts.append(values["action_space"])
    if (values["n"], values["m"]) != (usual.n, usual.m):
        parts.append(f"n{values['n']}m{values['m']}")
    if values["views"] != usual.views:
        parts.append(f"{values['views']}views")
    if values["weights"]:
        parts.append(Path(values["weights"]).stem)
    if values["dataset"]:
        parts.append(Path(values["dataset"]).stem)
    return "runs/" + "-".join([*parts, str(values["seed"])])


class Difference(NamedTuple):
    """One setting in which two configs differ."""

    field: str
    old: Any
    new: Any
    changes_program: bool
    """Whether a run that changes it half-way is another run."""

    def __str__(self) -> str:
        return f"{self.field}: {self.old!r} -> {self.new!r}"


def differences(old: TrainConfig, new: TrainConfig) -> list[Difference]:
    """The settings in which two resolved configs differ, in the order they are declared."""
    free = FREE_TO_CHANGE
    if old.schedule == new.schedule == "constant":
        free |= {"steps"}  # A constant rate does not know how long the run is.
    pairs = ((f.name, getattr(old, f.name), getattr(new, f.name)) for f in dataclasses.fields(old))
    return [Difference(name, a, b, name not in free) for name, a, b in pairs if a != b]


def _check_window(n: int | None, m: int | None) -> None:
    if n is not None and m is not None and m > n:
        raise ConfigError(f"m ({m}) must be at most n ({n}), or cameras would be skipped.")


def _check_train(config: TrainConfig) -> None:
    _check_window(config.n, config.m)
    if None not in (config.views, config.n) and config.views > config.n:
        raise ConfigError(f"views ({config.views}) needs as many cameras: raise n ({config.n}).")
    if config.crop_min is not None and config.crop_min > 1:
        raise ConfigError(f"crop_min is a share of the image, at most 1; got {config.crop_min}.")
    for field in ("ema", "beta1", "beta2"):
        value = getattr(config, field)
        if value is not None and value >= 1:
            raise ConfigError(f"{field} must be below 1, got {value}.")
    if None not in (config.warmup, config.steps) and config.warmup >= config.steps:
        raise ConfigError(f"warmup ({config.warmup}) must be shorter than steps ({config.steps}).")
    if len(set(config.seeds)) < len(config.seeds) or min(config.seeds, default=0) < 0:
        raise ConfigError(f"seeds must be different and at least 0, got {config.seeds}.")
    if config.batch is not None and config.batch % config.accumulate:
        raise ConfigError(
            f"batch ({config.batch}) must be a multiple of accumulate ({config.accumulate})."
        )
    if config.steps_per_call is None:
        return
    for field in ("steps", "log_every", "eval_every", "save_every"):
        value = getattr(config, field)
        if value is not None and value % config.steps_per_call:
            raise ConfigError(
                f"{field} ({value}) must be a multiple of steps_per_call ({config.steps_per_call})."
            )
