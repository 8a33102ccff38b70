"""Which run is this: its settings in full, its folder's name, and in what two runs differ."""

import dataclasses
import math
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from jaxcam.config.datasets import CollectConfig, RobomimicConfig
from jaxcam.config.presets import PRESETS, USUAL
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError

C = TypeVar("C", TrainConfig, CollectConfig, RobomimicConfig)


# Settings that leave every update of a run as it was; all others are part of a run's identity.
FREE_TO_CHANGE = frozenset({
    "pairs", "engine", "ensemble", "data_dir", "dataset", "run_dir", "log_every", "eval_every",
    "save_every", "keep", "videos", "seeds", "log", "distributed",
})  # fmt: skip


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
