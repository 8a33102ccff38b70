"""Every setting of every command: frozen records, their presets, their JSON form and their flags.

A setting declared as `FromPreset[T]` may be left out; `resolve` fills it from the preset of the
policy. Attribute docstrings are what `--help` prints. Nothing here imports JAX, so help is fast.
"""

from dataclasses import dataclass
from typing import Annotated

import tyro

from jaxcam.config.fields import (
    PRESET,
    FromPreset,
    check_least,
    check_names,
    check_types,
    check_window,
    default,
    one_of,
    overrides,
)
from jaxcam.errors import ConfigError


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


def _check_train(config: TrainConfig) -> None:
    check_window(config.n, config.m)
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
