"""Policies: networks defined with Flax nnx, handed out as pure functions over dicts of arrays."""

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from jaxcam.errors import ConfigError
from jaxcam.models.act import (
    ACT_PRESETS,
    Act,
    ActConfig,
    action_scale,
    l1_loss,
    proprio_scale,
    with_conditioning,
)
from jaxcam.models.policy import Batch, Key, Obs, Params, Policy, PolicySpec

if TYPE_CHECKING:
    from jaxcam.checkpoint import PolicyInputs
    from jaxcam.config import TrainConfig

__all__ = [
    "ACT_PRESETS",
    "ActConfig",
    "Batch",
    "Key",
    "Obs",
    "Params",
    "Policy",
    "PolicySpec",
    "make_policy",
    "policy_settings",
    "rebuild_policy",
    "with_conditioning",
]


def _string_keys(tree: Any) -> Any:
    """Layer numbers as strings, so that parameters look the same in memory and in checkpoints."""
    if isinstance(tree, dict):
        return {str(name): _string_keys(value) for name, value in tree.items()}
    return tree


def make_policy(config: ActConfig, spec: PolicySpec, stats: Mapping[str, np.ndarray]) -> Policy:
    """Make a policy's three functions.

    Args:
        config: The policy's settings.
        spec: Sizes of observations and actions.
        stats: ``action_mean``, ``action_std`` [A] and ``proprio_mean``, ``proprio_std`` [P] of the
            training data, with ``keyframe_mean``, ``keyframe_std`` [3] if keyframes are predicted.
            They become constants of the functions.

    Returns:
        The policy. Its parameters are nested dicts with string keys.

    Raises:
        ConfigError: If settings, sizes and statistics do not go together.
    """
    if config.chunk != spec.chunk:
        raise ConfigError(
            f"The policy predicts {config.chunk} actions but the data has chunks of {spec.chunk}."
        )
    action_mean = np.asarray(stats["action_mean"], np.float32)
    action_std = action_scale(stats["action_std"])
    proprio_mean = np.asarray(stats["proprio_mean"], np.float32)
    proprio_std = proprio_scale(stats["proprio_std"])
    for name, got, expected in (
        ("action", action_mean, spec.action_dim),
        ("proprio", proprio_mean, spec.proprio_dim),
    ):
        if got.shape != (expected,):
            raise ConfigError(
                f"Statistics of {name} have shape {got.shape}; the policy expects ({expected},)."
            )

    def build(rngs: nnx.Rngs) -> Act:
        return Act(config, spec, rngs=rngs)

    graphdef, _ = nnx.split(nnx.eval_shape(lambda: build(nnx.Rngs(0))))

    def init(key: jax.Array) -> Params:
        return _string_keys(nnx.to_pure_dict(nnx.split(build(nnx.Rngs(key)))[1]))

    def network(params: Params) -> Act:
        return nnx.merge(graphdef, nnx.restore_int_paths(params))

    def proprio(obs: Obs) -> jax.Array:
        raw = jnp.zeros_like(obs["proprio"]) if config.drop_proprio else obs["proprio"]
        return (raw - proprio_mean) / proprio_std

    def loss(params: Params, batch: Batch, key: Key) -> tuple[jax.Array, dict[str, jax.Array]]:
        target = (batch["action"] - action_mean) / action_std
        is_pad = batch["is_pad"]
        predicted, kl = network(params)(batch, proprio(batch), target, is_pad, key=key)
        l1 = l1_loss(predicted[..., : spec.action_dim], target, is_pad)
        total = l1 + config.kl_weight * kl
        metrics = {"l1": l1, "kl": kl}
        if config.keyframe_weight:
            keyframe = (batch["keyframe"] - stats["keyframe_mean"]) / stats["keyframe_std"]
            metrics["keyframe"] = l1_loss(predicted[..., spec.action_dim :], keyframe, is_pad)
            total += config.keyframe_weight * metrics["keyframe"]
        return total, {"loss": total, **metrics}

    def act(params: Params, obs: Obs, key: Key) -> jax.Array:
        del key  # ACT acts with its latent at zero: nothing is drawn.
        predicted = network(params)(obs, proprio(obs))[0][..., : spec.action_dim]
        return predicted * action_std + action_mean

    return Policy(init, loss, act, config, spec, min(config.execute or spec.chunk, spec.chunk))


def policy_settings(config: "TrainConfig") -> ActConfig:
    """The network's settings that a run's resolved settings ask for."""
    from jaxcam.fields import with_overrides

    settings = with_conditioning(ACT_PRESETS[config.preset], config.conditioning)
    return with_overrides(replace(settings, compute_dtype=config.precision), config.model)


def rebuild_policy(inputs: "PolicyInputs") -> Policy:
    """The policy of a checkpoint, as it was trained."""
    return make_policy(ActConfig(**inputs.settings), PolicySpec(**inputs.spec), inputs.stats)
