"""Every setting of every command: frozen records, their presets, their JSON form and their flags.

A setting declared as `FromPreset[T]` may be left out; `resolve` fills it from the preset of the
policy. Attribute docstrings are what `--help` prints. Nothing here imports JAX, so help is fast.
"""

import ast
import dataclasses
import json
import math
import typing
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeVar

import tyro

from jaxcam.errors import ConfigError, closest

# The settings that are names, and the names there are.
NAMES: dict[str, tuple[str, ...]] = {
    "task": ("lift",),
    "scene": ("fixed", "randomized"),
    "policy": ("act",),
    "preset": ("auto", "laptop", "paper"),
    "conditioning": ("none", "token", "early", "late", "keypoints"),
    "action_space": ("eef_delta", "eef_abs", "joint_delta", "joint_abs"),
    "schedule": ("constant", "cosine"),
    "precision": ("float32", "bfloat16"),
    "split": ("test", "validation"),
}

# The values a preset gives. The paper's come from the authors' released run settings; an epoch of
# theirs is 3 updates, and they evaluate and save every 1000 epochs.
PRESETS: dict[tuple[str, str], dict[str, Any]] = {
    ("act", "paper"): {
        "conditioning": "late", "precision": "bfloat16", "resolution": 256,
        "steps": 60_000, "batch": 70, "lr": 2e-5, "weight_decay": 1e-4,
        "schedule": "constant", "warmup": 0, "crop_min": 0.8,
        "log_every": 50, "eval_every": 3000, "save_every": 3000, "steps_per_call": 10,
    },
    ("act", "laptop"): {
        "conditioning": "keypoints", "precision": "float32", "resolution": 84,
        "steps": 4000, "batch": 64, "lr": 1e-3, "weight_decay": 1e-4,
        "schedule": "cosine", "warmup": 200, "crop_min": 0.8,
        "log_every": 50, "eval_every": 500, "save_every": 500, "steps_per_call": 10,
    },
}  # fmt: skip

# Settings that leave every update of a run as it was; all others are part of a run's identity.
FREE_TO_CHANGE = frozenset(
    {"pairs", "data_dir", "run_dir", "log_every", "eval_every", "save_every", "keep"}
)

T = TypeVar("T")
C = TypeVar("C")
if TYPE_CHECKING:  # Every reader of a config sees it resolved, so for them the value is a plain T.
    FromPreset = Annotated[T, "from the preset"]
else:

    class FromPreset:
        """`FromPreset[T]` is `T | None` with the help text of a plain T."""

        def __class_getitem__(cls, kind):
            hint = "(default: the preset's)"
            return Annotated[
                kind | None, tyro.conf.arg(metavar=kind.__name__.upper(), help_behavior_hint=hint)
            ]


PRESET: Any = None


def _one_of(field: str) -> Any:
    return tyro.conf.arg(metavar="{" + ",".join(NAMES[field]) + "}")


def _default(text: str) -> Any:
    return tyro.conf.arg(help_behavior_hint=f"(default: {text})")


@dataclass(frozen=True)
class TrainConfig:
    """Train a policy, evaluate it on camera poses it never saw, and write a report.

    Missing demonstrations are collected first. The same command run again resumes.
    """

    task: Annotated[str, _one_of("task")] = "lift"
    """What the robot has to do."""
    scene: Annotated[str, _one_of("scene")] = "randomized"
    """Whether robot and table stand still or move from episode to episode."""
    policy: Annotated[str, _one_of("policy")] = "act"
    """The kind of policy."""
    preset: Annotated[str, _one_of("preset")] = "auto"
    """Where unset values come from; auto is paper on an accelerator and laptop without one."""
    conditioning: Annotated[FromPreset[str], _one_of("conditioning")] = PRESET
    """How the policy is told where its cameras are."""
    action_space: Annotated[str, _one_of("action_space")] = "eef_delta"
    """What the policy's actions mean."""
    views: int = 1
    """Cameras the policy sees at once."""
    seed: int = 0
    """Seed of the weights, the order of the data, the crops and the dropout."""

    steps: FromPreset[int] = PRESET
    """Updates in all."""
    batch: FromPreset[int] = PRESET
    """Samples an update."""
    lr: FromPreset[float] = PRESET
    """Learning rate at its peak."""
    schedule: Annotated[FromPreset[str], _one_of("schedule")] = PRESET
    """Course of the learning rate after the warm-up."""
    warmup: FromPreset[int] = PRESET
    """Updates over which the learning rate rises to its peak."""
    weight_decay: FromPreset[float] = PRESET
    """AdamW's weight decay."""
    clip_norm: float = 1.0
    """Largest global norm of a gradient."""
    ema: float = 0.0
    """Decay of the weights' moving average, which is then evaluated; 0 is off."""
    precision: Annotated[FromPreset[str], _one_of("precision")] = PRESET
    """Arithmetic of the networks; weights and rays are always float32."""
    resolution: FromPreset[int] = PRESET
    """Image side in pixels."""
    crop_min: FromPreset[float] = PRESET
    """Smallest side of a random crop as a share of the image; 1 is off."""
    model: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE ...")] = ()
    """Changes to the policy's network as name=value, for example width=256."""

    n: int = 3
    """Cameras a demonstration is seen from."""
    m: int = 1
    """Cameras by which that window moves from one demonstration to the next."""
    demos: int = 200
    """Training demonstrations."""
    validation: int = 10
    """Validation demonstrations."""
    pairs: int = 50
    """Held-out (initial state, camera pose) pairs of the final evaluation."""

    data_dir: str = "data"
    """Folder of the datasets."""
    run_dir: Annotated[FromPreset[str], _default("runs/TASK-SCENE-POLICY-...-SEED")] = PRESET
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

    def __post_init__(self) -> None:
        _check_types(self)
        _check_names(self)
        _check_least(self, 1, "views steps batch n demos pairs keep log_every eval_every")
        _check_least(self, 1, "save_every steps_per_call")
        _check_least(self, 0, "seed warmup weight_decay m validation ema")
        _check_least(self, 16, "resolution")
        _check_least(self, 0, "lr clip_norm crop_min", or_equal=False)
        _check_train(self)
        overrides(self.model)


@dataclass(frozen=True)
class EvaluateConfig:
    """Evaluate a run's checkpoint on held-out initial states and camera poses."""

    run: tyro.conf.Positional[str]
    """Folder of the run."""
    step: Annotated[int | None, tyro.conf.arg(metavar="INT"), _default("newest whole one")] = None
    """Checkpoint to evaluate."""
    pairs: int = 50
    """(Initial state, camera pose) pairs."""
    split: Annotated[str, _one_of("split")] = "test"
    """Which pairs: those kept for results, or those for choosing settings."""
    width: int = 50
    """Rollouts simulated at once; rows of different widths are not mixed."""
    videos: int = 16
    """Rollouts shown in the video; 0 is none."""

    def __post_init__(self) -> None:
        _check_types(self)
        _check_names(self)
        _check_least(self, 1, "pairs width")
        _check_least(self, 0, "step videos")


@dataclass(frozen=True)
class CollectConfig:
    """Collect demonstrations of the scripted expert: states, commands and camera poses."""

    task: Annotated[str, _one_of("task")] = "lift"
    """What the robot has to do."""
    scene: Annotated[str, _one_of("scene")] = "randomized"
    """Whether robot and table stand still or move from episode to episode."""
    demos: int = 200
    """Training demonstrations."""
    validation: int = 10
    """Validation demonstrations."""
    n: int = 3
    """Cameras a demonstration is seen from."""
    m: int = 1
    """Cameras by which that window moves from one demonstration to the next."""
    seed: int = 0
    """Seed of the initial states and of the expert."""
    data_dir: str = "data"
    """Folder of the datasets."""

    def __post_init__(self) -> None:
        _check_types(self)
        _check_names(self)
        _check_least(self, 1, "demos n")
        _check_least(self, 0, "validation m seed")
        _check_window(self.n, self.m)


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
    if accelerator is None:
        import jax

        accelerator = jax.default_backend() != "cpu"
    preset = config.preset
    if preset == "auto":
        preset = "paper" if accelerator else "laptop"
    values = dict(PRESETS[config.policy, preset], preset=preset)
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
        names = ("task", "scene", "policy", "preset", "conditioning", "seed")
        values["run_dir"] = "runs/" + "-".join(str(values[k]) for k in names)
    return TrainConfig(**values)


def to_json(config: Any) -> str:
    """A config as JSON text that `from_json` turns back into an equal config."""
    return json.dumps(dataclasses.asdict(config), indent=2) + "\n"


def from_json(kind: type[C], text: str) -> C:
    """The config a JSON text holds.

    Args:
        kind: Config class.
        text: What `to_json` wrote. Settings it lacks, because it is older, take their defaults.

    Raises:
        ConfigError: The text is not JSON, or a name or value in it is not this class's.
    """
    try:
        values = json.loads(text)
    except ValueError as error:
        raise ConfigError(f"The configuration is not JSON: {error}.") from error
    if not isinstance(values, dict):
        raise ConfigError(f"The configuration is a JSON {type(values).__name__}, not an object.")
    known = [f.name for f in dataclasses.fields(kind)]  # pyright: ignore[reportArgumentType]
    for name in values:
        if name not in known:
            raise ConfigError(f"Unknown setting '{name}'{closest(name, known)}.")
    return kind(**{k: tuple(v) if isinstance(v, list) else v for k, v in values.items()})


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


def overrides(pairs: Iterable[str]) -> dict[str, Any]:
    """Name=value texts as a dict; numbers, booleans, tuples and None become such."""
    values: dict[str, Any] = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if not (name.isidentifier() and equals and text):
            raise ConfigError(f"model: expected name=value, got '{pair}'.")
        if name in values:
            raise ConfigError(f"model: '{name}' is given twice.")
        try:
            values[name] = ast.literal_eval({"true": "True", "false": "False"}.get(text, text))
        except (ValueError, SyntaxError):
            values[name] = text
    return values


def with_overrides(settings: C, pairs: Iterable[str]) -> C:
    """A policy's settings with the changes of `TrainConfig.model`.

    Args:
        settings: A frozen dataclass, such as a policy's preset.
        pairs: Texts such as "width=256".

    Raises:
        ConfigError: No such setting, or a value of another type.
    """
    values = overrides(pairs)
    known = [f.name for f in dataclasses.fields(settings)]  # pyright: ignore[reportArgumentType]
    for name in values:
        if name not in known:
            raise ConfigError(f"model: unknown setting '{name}'{closest(name, known)}.")
    changed = dataclasses.replace(settings, **values)  # pyright: ignore[reportArgumentType]
    _check_types(changed, where="model: ")
    return typing.cast(C, changed)


def cli(kind: type[C], argv: Sequence[str] | None = None, *, prog: str | None = None) -> C:
    """A config from the flags in `argv`, or the process's; bad ones print a box and exit with 2."""
    return tyro.cli(kind, args=argv, prog=prog)


def _check_types(config: Any, where: str = "") -> None:
    for name, hint in typing.get_type_hints(type(config)).items():
        value = getattr(config, name)
        kinds = tuple(typing.get_origin(t) or t for t in (typing.get_args(hint) or (hint,)))
        if typing.get_origin(hint) is tuple:
            kinds = (tuple,)
        is_number = type(value) is int and float in kinds
        if all(isinstance(k, type) for k in kinds) and type(value) not in kinds and not is_number:
            wanted = " or ".join(k.__name__ for k in kinds)
            raise ConfigError(f"{where}{name} must be {wanted}, got {value!r}.")


def _check_names(config: Any) -> None:
    for field, known in NAMES.items():
        value = getattr(config, field, None)
        if value is not None and value not in known:
            raise ConfigError(f"Unknown {field} '{value}'{closest(value, known)}.")


def _check_least(config: Any, least: float, fields: str, *, or_equal: bool = True) -> None:
    for field in fields.split():
        value = getattr(config, field)
        if value is None:
            continue
        if not math.isfinite(value) or value < least or (value == least and not or_equal):
            bound = "at least" if or_equal else "finite and more than"
            raise ConfigError(f"{field} must be {bound} {least}, got {value}.")


def _check_window(n: int, m: int) -> None:
    if m > n:
        raise ConfigError(f"m ({m}) must be at most n ({n}), or cameras would be skipped.")


def _check_train(config: TrainConfig) -> None:
    _check_window(config.n, config.m)
    if config.views > config.n:
        raise ConfigError(f"views ({config.views}) needs as many cameras: raise n ({config.n}).")
    if config.crop_min is not None and config.crop_min > 1:
        raise ConfigError(f"crop_min is a share of the image, at most 1; got {config.crop_min}.")
    if config.ema >= 1:
        raise ConfigError(f"ema must be below 1, got {config.ema}.")
    if None not in (config.warmup, config.steps) and config.warmup >= config.steps:
        raise ConfigError(f"warmup ({config.warmup}) must be shorter than steps ({config.steps}).")
    if config.steps_per_call is None:
        return
    for field in ("steps", "log_every", "eval_every", "save_every"):
        value = getattr(config, field)
        if value is not None and value % config.steps_per_call:
            raise ConfigError(
                f"{field} ({value}) must be a multiple of steps_per_call ({config.steps_per_call})."
            )
