"""The values that a policy's presets give to the settings that are left open."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from jaxcam.config.names import (
    ActionChoice,
    Conditioning,
    OptimizerName,
    PolicyName,
    Precision,
    PresetName,
    ScheduleName,
)


@dataclass(frozen=True, kw_only=True)
class Preset:
    """Values of the settings of `TrainConfig` that have these names."""

    conditioning: Conditioning
    precision: Precision
    resolution: int
    steps: int
    batch: int
    lr: float
    weight_decay: float
    schedule: ScheduleName
    warmup: int
    crop_min: float
    log_every: int
    eval_every: int
    save_every: int
    action_space: ActionChoice = "eef_delta"
    model: tuple[str, ...] = ()
    """Changes to the network, which stand in a run's settings beside those that are asked."""
    before: tuple[str, ...] = ()
    """The same of runs that do not say them, since they are older than these changes."""
    steps_per_call: int = 10
    optimizer: OptimizerName = "adamw"
    beta1: float = 0.9
    beta2: float = 0.999
    clip_norm: float = 1.0
    final_lr: float = 0.0
    ema: float = 0.0
    ema_power: float = 0.0


# The values a preset gives. The paper's come from the authors' released run settings; an epoch of
# theirs is 3 updates, and they evaluate and save every 1000 epochs. Those of original are the
# repositories' (2000 epochs of 200 demonstrations for ACT, about 3000 for Diffusion Policy), those
# of lerobot the defaults of its version 0.4.4.
PRESETS: dict[tuple[PolicyName, PresetName], Preset] = {
    ("act", "paper"): Preset(
        conditioning="late", precision="bfloat16", resolution=256,
        steps=60_000, batch=70, lr=2e-5, weight_decay=1e-4,
        schedule="constant", warmup=0, crop_min=0.8,
        log_every=50, eval_every=3000, save_every=3000,
    ),
    ("act", "lerobot"): Preset(
        conditioning="none", precision="float32", resolution=256,
        steps=100_000, batch=8, lr=1e-5, weight_decay=1e-4, clip_norm=10.0,
        schedule="constant", warmup=0, crop_min=1.0,
        log_every=200, eval_every=20_000, save_every=20_000,
    ),
    ("act", "original"): Preset(
        conditioning="none", precision="float32", resolution=480,
        steps=50_000, batch=8, lr=1e-5, weight_decay=1e-4, clip_norm=0.0,
        schedule="constant", warmup=0, crop_min=1.0,
        log_every=50, eval_every=2500, save_every=2500,
    ),
    ("act", "laptop"): Preset(
        conditioning="keypoints", action_space="eef_abs", precision="float32", resolution=84,
        steps=4000, batch=64, lr=1e-3, weight_decay=1e-4,
        schedule="cosine", warmup=200, crop_min=0.8,
        log_every=50, eval_every=500, save_every=500,
    ),
    # Given its joints it repeats where it is, and learns nothing else.
    ("act", "attention"): Preset(
        conditioning="late", action_space="eef_abs", precision="float32", resolution=84,
        model=("drop_proprio=true",), before=("drop_proprio=false",),
        steps=4000, batch=64, lr=1e-3, weight_decay=1e-4,
        schedule="cosine", warmup=200, crop_min=0.8,
        log_every=50, eval_every=500, save_every=500,
    ),
    ("diffusion", "paper"): Preset(
        conditioning="early", precision="bfloat16", resolution=256,
        steps=300_000, batch=70, lr=2e-5, weight_decay=1e-4,
        schedule="constant", warmup=0, crop_min=0.8,
        log_every=50, eval_every=6000, save_every=6000,
    ),
    ("diffusion", "lerobot"): Preset(
        conditioning="none", precision="float32", resolution=96,
        steps=100_000, batch=64, lr=1e-4, weight_decay=1e-6, clip_norm=10.0,
        optimizer="adam", beta1=0.95, schedule="cosine", warmup=500, crop_min=1.0,
        log_every=200, eval_every=20_000, save_every=20_000,
    ),
    ("diffusion", "original"): Preset(
        conditioning="none", precision="float32", resolution=84,
        steps=450_000, batch=64, lr=1e-4, weight_decay=1e-6, clip_norm=0.0,
        beta1=0.95, schedule="cosine", warmup=500, crop_min=1.0,
        ema=0.9999, ema_power=0.75,
        log_every=150, eval_every=7500, save_every=7500,
    ),
    ("diffusion", "laptop"): Preset(
        conditioning="keypoints", precision="float32", resolution=84,
        steps=4000, batch=64, lr=1e-3, weight_decay=1e-4,
        schedule="cosine", warmup=200, crop_min=0.8, ema=0.995, ema_power=0.75,
        log_every=50, eval_every=500, save_every=500,
    ),
    # The authors' first update has a rate of 0, ours one step's share of the warm-up.
    ("smolvla", "paper"): Preset(
        conditioning="late", precision="bfloat16", resolution=256,
        steps=90_000, batch=70, lr=1e-4, weight_decay=1e-3,
        schedule="cosine", warmup=4500, crop_min=0.8,
        log_every=50, eval_every=3000, save_every=3000,
    ),
    ("smolvla", "lerobot"): Preset(
        conditioning="none", precision="bfloat16", resolution=256,
        steps=30_000, batch=64, lr=1e-4, weight_decay=1e-10, clip_norm=10.0,
        beta2=0.95, schedule="cosine_from_start", warmup=1000, final_lr=2.5e-6, crop_min=1.0,
        log_every=200, eval_every=3000, save_every=3000,
    ),
    ("smolvla", "laptop"): Preset(
        conditioning="keypoints", precision="float32", resolution=84,
        steps=4000, batch=64, lr=1e-3, weight_decay=1e-4,
        schedule="cosine", warmup=200, crop_min=0.8, ema=0.995, ema_power=0.75,
        log_every=50, eval_every=500, save_every=500,
    ),
    # For tests: the paper's form, small enough for a CPU, without a tokenizer.
    ("smolvla", "tiny"): Preset(
        conditioning="late", precision="float32", resolution=64,
        steps=200, batch=8, lr=1e-3, weight_decay=1e-4,
        schedule="cosine", warmup=10, crop_min=0.8,
        log_every=10, eval_every=50, save_every=100, steps_per_call=1,
    ),
}  # fmt: skip

# What single tasks need otherwise; docs/results.md has what was tried.
OF_TASKS: dict[tuple[PolicyName, PresetName, str], dict[str, Any]] = {
    ("act", "laptop", "lift"): {"steps": 2000},
    ("act", "laptop", "square"): {
        "steps": 6000,
        "model": ("heatmap_weight=1", "lift_unit=0.125"),
        "before": ("heatmap_weight=0", "lift_unit=0"),
    },
    ("act", "attention", "lift"): {"steps": 2000},
}


def preset_of(policy: PolicyName, preset: PresetName, task: str) -> Preset:
    """The values that a preset of a policy gives to a task.

    Raises:
        KeyError: The policy has no such preset.
    """
    return replace(PRESETS[policy, preset], **OF_TASKS.get((policy, preset, task), {}))


def unsaid(own: Iterable[str], model: Iterable[str]) -> list[str]:
    """A preset's changes to a network of which others, `name=value` too, say nothing.

    Args:
        own: The preset's.
        model: The others.
    """
    names = {change.partition("=")[0] for change in model}
    return [change for change in own if change.partition("=")[0] not in names]
