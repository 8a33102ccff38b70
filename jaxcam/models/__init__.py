"""Policies: networks defined with Flax nnx, handed out as pure functions over dicts of arrays."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from jaxcam.config.fields import overrides, with_overrides
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.models.act.config import ACT_PRESETS, ActConfig
from jaxcam.models.act.policy import FAMILY as ACT
from jaxcam.models.action_frame import in_action_frame
from jaxcam.models.diffusion.policy import FAMILY as DIFFUSION
from jaxcam.models.policy import Batch, Family, Key, Obs, Params, Policy, PolicySpec, Stats
from jaxcam.models.smolvla.policy import FAMILY as SMOLVLA

__all__ = [
    "ACT_PRESETS",
    "FAMILIES",
    "ActConfig",
    "Batch",
    "Family",
    "Key",
    "Obs",
    "Params",
    "Policy",
    "PolicySpec",
    "Stats",
    "make_policy",
    "policy_settings",
]

FAMILIES: dict[str, Family[Any]] = {
    "act": ACT,
    "diffusion": DIFFUSION,
    "smolvla": SMOLVLA,
}
"""Every kind of policy by the name it has on the command line."""


_OF_THE_ACTIONS = {"action_frame", "absolute_actions", "base_from_actions"}


def make_policy(config: Any, spec: PolicySpec, stats: Stats) -> Policy:
    """Make a policy's three functions.

    Args:
        config: The policy's settings, of the class of one of the `FAMILIES`.
        spec: Sizes of observations and actions.
        stats: Statistics of the training data; they become constants of the functions.

    Returns:
        The policy. Its parameters are nested dicts with string keys.

    Raises:
        ConfigError: If settings, sizes and statistics do not go together.
    """
    family = next(f for f in FAMILIES.values() if f.config is type(config))
    return in_action_frame(family.make(config, spec, stats))


def _check_true_cameras(config: TrainConfig) -> None:
    """Refuses to teach heat maps where batches do not say where the cameras are, in the base."""
    for flag, given, true in (
        ("ray-frame", config.ray_frame, "base"),
        ("rays-from", config.rays_from, "true"),
        ("pose-noise", config.pose_noise, ""),
    ):
        if given != true:
            raise ConfigError(
                "model: heatmap_weight is taught by the cameras' true poses and intrinsics in the "
                f"base, which --{flag} {given} changes. --model heatmap_weight=0 teaches none."
            )


def policy_settings(
    config: TrainConfig, prompts: Sequence[str], base_from_actions: np.ndarray | None = None
) -> Any:
    """The network's settings that a run's resolved settings ask for.

    Args:
        config: Resolved settings of the run.
        prompts: What is asked for, in words: one thing, or the several that a dataset has.
        base_from_actions: The frame that the actions are in [4, 4]; the base's when None.

    Raises:
        ConfigError: A change that `config.model` asks for is unknown or cannot work.
    """
    family = FAMILIES[config.policy]
    if config.conditioning != "none" and "twin_of" in overrides(config.model):
        raise ConfigError(
            f"model: twin_of is for --conditioning none, not {config.conditioning}: it says whose "
            "network is fed with one fixed pose."
        )
    settings = family.conditioned(family.presets[config.preset], config.conditioning)
    settings = with_overrides(replace(settings, compute_dtype=config.precision), config.model)
    if taken := overrides(config.model).keys() & _OF_THE_ACTIONS:
        raise ConfigError(f"model: {min(taken)} follows from --action-frame and --action-space.")
    if config.action_frame == "camera":
        frame = np.eye(4) if base_from_actions is None else base_from_actions
        settings = replace(
            settings,
            action_frame="camera",
            absolute_actions=config.action_space == "eef_abs",
            base_from_actions=tuple(tuple(map(float, row)) for row in frame),
        )
    if getattr(settings, "heatmap_weight", 0):
        _check_true_cameras(config)
    ahead = settings.chunk - settings.obs_steps + 1
    # A preset's number may be more than a chunk that is shortened has; one that is asked may not.
    if "execute" in overrides(config.model) and settings.execute > ahead:
        raise ConfigError(f"model: execute must be at most {ahead}, got {settings.execute}.")
    return family.instructed(settings, prompts)
