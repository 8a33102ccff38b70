"""The settings of a training run.

A setting declared as `FromPreset[T]` may be left out; `resolve` fills it from the preset of the
policy.
"""

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, cast

import tyro

from jaxcam.config.conditions import NOMINAL, OPTICS, Conditions, keep_canonical
from jaxcam.config.fields import (
    check_action_frame,
    check_least,
    check_most,
    check_ray_frame,
    check_rotation_form,
    check_seeds,
    check_types,
    check_window,
    overrides,
)
from jaxcam.config.flags import PRESET, FromPreset, Groups, default
from jaxcam.config.names import (
    ActionChoice,
    ActionFrame,
    ActionMeaning,
    Conditioning,
    EngineChoice,
    LoggerName,
    OptimizerName,
    PolicyName,
    PoseNoisePer,
    Precision,
    PresetName,
    RayFrame,
    RaysFrom,
    Rotations,
    SceneName,
    ScheduleName,
    Stem,
    Subject,
)
from jaxcam.config.presets import PRESETS, unsaid
from jaxcam.config.sizes import rows_and_columns
from jaxcam.errors import ConfigError

MOST_DEMOS = 100_000
"""Demonstrations, and cameras of one: episode seeds of more would reach those of the pairs."""


@dataclass(frozen=True)
class TrainConfig:
    """Train a policy, evaluate it on camera poses it never saw, and write a report.

    Missing demonstrations are collected first. The same command run again resumes.
    """

    GROUPS: ClassVar[Groups] = {
        "": "task scene policy preset conditioning seed steps demos pairs dataset cameras run_dir",
        "network": "conditioning action_space action_frame ray_frame rotations model weights stem",
        "updates": "steps batch accumulate lr schedule warmup final_lr optimizer weight_decay "
        "beta1 beta2 clip_norm ema ema_power precision",
        "data": "n m views demos validation resolution crop_min color_jitter data_dir",
        "cameras": "fovy eval_fovy pose_noise pose_noise_per rays_from lens centre aspect",
        "recorded": "dataset cameras grip action_is hold_out_view hold_out_episodes",
        "evaluation": "pairs engine ensemble videos",
        "run": "seed seeds run_dir log_every eval_every save_every keep steps_per_call log "
        "distributed",
    }

    task: Subject = "lift"
    """What the robot has to do; recorded is what the --dataset shows, where that is a folder."""
    scene: SceneName = "randomized"
    """Whether robot and table stand still or move from episode to episode."""
    policy: PolicyName = "act"
    """The kind of policy."""
    preset: PresetName = "auto"
    """Where unset values come from; auto is paper on an accelerator and laptop without one."""
    conditioning: FromPreset[Conditioning] = PRESET
    """How the policy is told where its cameras are."""
    action_space: Annotated[
        FromPreset[ActionChoice], default("the preset's, or a recorded dataset's own")
    ] = PRESET
    """What the policy's actions mean; native is whatever a recorded dataset's do. Grip poses become
    what they move by and back, and so do joint angles."""
    action_frame: ActionFrame = "base"
    """What the policy predicts eef_delta or eef_abs in: the robot's own frame, or that of its first
    camera, whose pose makes them the robot's again."""
    rotations: Rotations = "nominal"
    """What the rotation vectors of eef_abs are counted from: a grip that points down, where they
    are small, or the world's axes, as until version 0.1.0, where they jump."""
    views: Annotated[FromPreset[int], default("the task's")] = PRESET
    """Cameras the policy sees at once."""
    pose_noise: Annotated[str, tyro.conf.arg(metavar="DEG,CM"), default("none")] = ""
    """Error of the camera poses that the policy is told in training, such as 1,0.5: a turn by so
    many degrees about a random axis, and a shift by so many centimetres in a random direction."""
    pose_noise_per: PoseNoisePer = "sample"
    """What a new error is drawn for: each sample, or once for each camera of each episode, or once
    for each camera, as errors of a calibration are."""
    ray_frame: RayFrame = "base"
    """Where the rays are that the policy is told: in the frame of the robot's base, of the world or
    of the grip, or in the base's axes with moments about the grip or the table's middle."""
    rays_from: RaysFrom = "true"
    """Intrinsics that the policy is told: its cameras', or the task's usual ones whatever theirs
    are, which leaves it with the poses alone."""
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
    schedule: FromPreset[ScheduleName] = PRESET
    """Course of the learning rate after the warm-up: constant, a cosine that begins there, or the
    rest of one that began with the first update (LeRobot's SmolVLA)."""
    warmup: FromPreset[int] = PRESET
    """Updates over which the learning rate rises to its peak."""
    final_lr: FromPreset[float] = PRESET
    """Learning rate at the end of a cosine."""
    optimizer: FromPreset[OptimizerName] = PRESET
    """adamw decays the weights themselves, adam adds the decay to the gradient."""
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
    """The decay rises to --ema as 1 - update^-power; 0 starts with --ema itself."""
    precision: FromPreset[Precision] = PRESET
    """Arithmetic of the networks; weights and rays are always float32."""
    resolution: Annotated[FromPreset[int | str], tyro.conf.arg(metavar="SIDE|ROWSxCOLUMNS")] = (
        PRESET
    )
    """Size of the images in pixels, such as 84 or 96x128. Of recorded pictures, one number is the
    shorter side; the longer one keeps their shape."""
    crop_min: FromPreset[float] = PRESET
    """Smallest side of a random crop as a share of the image; 1 is off."""
    color_jitter: float = 0.0
    """Largest random change of brightness, contrast and saturation in training as a share of them,
    such as 0.4; hues turn by up to a quarter of it. 0 is off."""
    model: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE ..."), default("none")] = ()
    """Changes to the policy's network as name=value, for example width=256."""
    weights: Annotated[str, default("none")] = ""
    """File of weights to start from: those of an image encoder or of a whole policy, or the folder
    of a LeRobot checkpoint. See what a file holds with `python -m jaxcam.weights FILE`."""
    stem: Stem = "keep"
    """A first convolution that also takes the ray-map keeps the weights' kernel for colours, or
    starts anew, as the authors' does."""

    n: Annotated[FromPreset[int], default("the task's")] = PRESET
    """Cameras a demonstration is seen from."""
    m: Annotated[FromPreset[int], default("the task's")] = PRESET
    """How many cameras later the cameras of the next demonstration begin; 0 gives all the same."""
    fovy: Annotated[str, tyro.conf.arg(metavar="LOW:HIGH"), default("the task's")] = ""
    """Vertical fields of view of the cameras, in degrees, such as 35:55."""
    aspect: Annotated[str, tyro.conf.arg(metavar="LOW:HIGH"), default("1")] = ""
    """Width over height of what a square picture shows, such as 1:1.5."""
    centre: Annotated[str, tyro.conf.arg(metavar="LOW:HIGH"), default("0")] = ""
    """Distance of the principal point from the picture's middle, in heights of it."""
    lens: Annotated[str, tyro.conf.arg(metavar="MODEL:LOW:HIGH,..."), default("none")] = ""
    """Lenses: opencv or fisheye, and a range for each coefficient, such as opencv:-0.3:0."""
    demos: int = 200
    """Training demonstrations."""
    validation: int = 10
    """Validation demonstrations."""
    pairs: int = 50
    """Held-out (initial state, camera pose) pairs of the final evaluation."""
    engine: EngineChoice = "auto"
    """Physics of the final evaluation; auto is mjx-warp on an accelerator and native without, and
    for the tasks of ManiSkill sapien-gpu on an NVIDIA card and sapien without."""
    eval_fovy: Annotated[str, tyro.conf.arg(metavar="LOW:HIGH"), default("as --fovy")] = ""
    """Fields of view in the final evaluation, in degrees; nominal is the task's."""
    ensemble: float = 0.0
    """Rate of temporal ensembling in the final evaluation, such as ACT's 0.01: the policy is asked
    at every step, and all that it ever predicted for a step is averaged; 0 is off."""

    videos: int = 16
    """Rollouts in each of two videos of the final evaluation, one of the first pairs and one of
    failures; 0 is none."""

    data_dir: str = "data"
    """Folder of the datasets."""
    dataset: Annotated[str, default("collected")] = ""
    """What to train on: a file, for example an imported one, or the folder of a recorded dataset
    (LeRobot's or DROID's). It brings demos, validation, n, m."""
    cameras: Annotated[str, default("the dataset's own")] = ""
    """JSON file that says where the cameras of a recorded dataset stood."""
    grip: Annotated[str, default("by its names")] = ""
    """Where a recorded dataset's state has the grip's position, such as observation.state[0:3]."""
    action_is: ActionMeaning = "unknown"
    """What a recorded dataset's actions are, if it does not say so: grip poses (m, and rotation
    vectors or Euler angles) or joint angles (rad), where to be or how far to go."""
    hold_out_view: Annotated[tuple[str, ...], default("none")] = ()
    """Views of a recorded dataset that training does not see, to be judged on."""
    hold_out_episodes: Annotated[tuple[int, ...], default("--validation of them")] = ()
    """Numbers of a recorded dataset's episodes that training does not see."""
    run_dir: Annotated[FromPreset[str], default("runs/TASK-SCENE-POLICY-...-SEED")] = PRESET
    """Folder of the run."""
    log_every: FromPreset[int] = PRESET
    """Updates between rows of metrics."""
    eval_every: FromPreset[int] = PRESET
    """Updates between losses on the validation demonstrations."""
    save_every: FromPreset[int] = PRESET
    """Updates between checkpoints."""
    keep: int = 10
    """Newest checkpoints that are kept."""
    steps_per_call: FromPreset[int] = PRESET
    """Updates in one compiled call. Part of the run's identity: it moves the last digits."""
    log: Annotated[tuple[LoggerName, ...], default("none")] = ()
    """Where metrics go besides metrics.jsonl."""
    distributed: bool = False
    """Be one of several processes of one run: on Slurm, Open MPI or Kubernetes they find each
    other; elsewhere JAX_COORDINATOR_ADDRESS, JAX_NUM_PROCESSES and JAX_PROCESS_ID are read."""

    def given(self, names: str) -> list[str]:
        """Which of some settings are not their defaults, as flags.

        Args:
            names: Of settings, with spaces between.
        """
        changed = (n for n in names.split() if getattr(self, n) != getattr(TrainConfig, n))
        return ["--" + n.replace("_", "-") for n in changed]

    @classmethod
    def completed(cls, values: dict[str, Any]) -> dict[str, Any]:
        """Settings by name with those that older files lack, where that is not the default now."""
        if values.get("action_space") == "eef_abs" and "rotations" not in values:
            values = values | {"rotations": "world"}
        named = str(values.get("policy")), str(values.get("preset"))
        preset = PRESETS.get(named)  # pyright: ignore[reportArgumentType]
        if preset is not None and isinstance(given := values.get("model"), list):
            model = cast("list[Any]", given)
            values = values | {"model": [*unsaid(preset.before, map(str, model)), *model]}
        return values

    @property
    def conditions(self) -> Conditions:
        """Those of the final evaluation: cameras as in training, and poses as they are."""
        return Conditions.of(self, **({"fovy": self.eval_fovy} if self.eval_fovy else {}))

    def __post_init__(self) -> None:
        check_types(self)
        keep_canonical(self, "pose_noise", *OPTICS)
        if self.pose_noise_per != "sample" and not self.pose_noise:
            raise ConfigError("--pose-noise-per goes with --pose-noise: say how large errors are.")
        if self.eval_fovy != NOMINAL:
            keep_canonical(self, "eval_fovy")
        if (space := vars(self)["action_space"]) is not None:
            check_rotation_form(space, self.rotations)
        check_action_frame(vars(self)["action_space"], self.action_frame)
        check_ray_frame(self.ray_frame, self.action_frame, vars(self)["conditioning"])
        check_least(self, 1, "views steps batch n demos pairs keep log_every eval_every")
        check_least(self, 1, "save_every steps_per_call accumulate")
        check_least(self, 0, "warmup weight_decay m validation ema ema_power clip_norm")
        check_least(self, 0, "final_lr beta1 beta2 videos color_jitter")
        check_least(self, 0, "lr crop_min", or_equal=False)
        check_least(self, -1, "ensemble")
        check_most(self, 2**31 - 1, "steps log_every eval_every save_every warmup")
        check_most(self, 1_000_000, "batch accumulate keep steps_per_call pairs videos")
        check_most(self, MOST_DEMOS, "demos validation n m")
        if vars(self)["resolution"] is not None:
            rows_and_columns(self.resolution)
        check_seeds(self.seed, *self.seeds)
        _check_shares(self)
        _check_cameras(self)
        _check_updates(self)
        if len(set(self.seeds)) < len(self.seeds):
            raise ConfigError(f"seeds must be different, got {self.seeds}.")
        if self.seeds and self.seed:
            raise ConfigError("Give --seed or --seeds, not both.")
        overrides(self.model)


def _check_shares(config: TrainConfig) -> None:
    values = vars(config)
    if (values["crop_min"] or 0) > 1:
        raise ConfigError(f"crop_min is a share of the image, at most 1; got {config.crop_min}.")
    if config.color_jitter > 1:
        raise ConfigError(f"color_jitter is a share, at most 1; got {config.color_jitter}.")
    for field in ("ema", "beta1", "beta2"):
        if (values[field] or 0) >= 1:
            raise ConfigError(f"{field} must be below 1, got {values[field]}.")


def _check_cameras(config: TrainConfig) -> None:
    check_window(config.n, config.m)
    values = vars(config)
    if None not in (values["views"], values["n"]) and config.views > config.n:
        raise ConfigError(f"views ({config.views}) needs as many cameras: raise n ({config.n}).")


def _check_updates(config: TrainConfig) -> None:
    values = vars(config)
    if None not in (values["warmup"], values["steps"]) and config.warmup >= config.steps:
        raise ConfigError(f"warmup ({config.warmup}) must be shorter than steps ({config.steps}).")
    for field in ("steps", "log_every", "eval_every", "save_every"):
        _check_multiple(config, field, "steps_per_call")
    _check_multiple(config, "batch", "accumulate")


def _check_multiple(config: TrainConfig, field: str, of: str) -> None:
    value, unit = getattr(config, field), getattr(config, of)
    if None not in (value, unit) and value % unit:
        raise ConfigError(f"{field} ({value}) must be a multiple of {of} ({unit}).")
