"""ACT's three functions: action chunks, optionally with a variational latent."""

import jax
import jax.numpy as jnp

from jaxcam.models.act.config import ACT_PRESETS, ActConfig
from jaxcam.models.act.network import Act
from jaxcam.models.conditioning import with_conditioning
from jaxcam.models.keypoints import heatmap_loss
from jaxcam.models.losses import padded_mean
from jaxcam.models.normalization import (
    action_deviation,
    keyframe_deviation,
    proprio_deviation,
)
from jaxcam.models.policy import (
    Batch,
    Family,
    Key,
    Obs,
    Params,
    Policy,
    PolicySpec,
    Stats,
    check_sizes,
    keyframe_padding,
    pure,
)


def make_act(config: ActConfig, spec: PolicySpec, stats: Stats) -> Policy:
    """Make ACT's three functions; statistics become constants of them."""
    check_sizes(config.chunk, spec, stats)
    action_scale = action_deviation(stats, config.action_std_floor, floors=config.floors)
    proprio_scale = proprio_deviation(stats, floors=config.floors)
    init, network = pure(lambda rngs: Act(config, spec, rngs=rngs))

    def proprio(obs: Obs) -> jax.Array:
        raw = jnp.zeros_like(obs["proprio"]) if config.drop_proprio else obs["proprio"]
        return proprio_scale.normalised(raw)

    def l1_loss(predicted: jax.Array, target: jax.Array, is_pad: jax.Array) -> jax.Array:
        return padded_mean(jnp.abs(predicted - target), is_pad, config.padding)

    def loss(params: Params, batch: Batch, key: Key) -> tuple[jax.Array, dict[str, jax.Array]]:
        target = action_scale.normalised(batch["action"])
        is_pad = batch["is_pad"]
        prediction = network(params)(batch, proprio(batch), target, is_pad, key=key)
        predicted, kl = prediction.outputs, prediction.kl
        l1 = l1_loss(predicted[..., : spec.action_dim], target, is_pad)
        total = l1 + config.kl_weight * kl
        metrics = {"l1": l1, "kl": kl}
        if config.keyframe_weight:
            keyframe = keyframe_deviation(stats).normalised(batch["keyframe"])
            unknown = keyframe_padding(batch)
            metrics["keyframe"] = l1_loss(predicted[..., spec.action_dim :], keyframe, unknown)
            total += config.keyframe_weight * metrics["keyframe"]
        if config.heatmap_weight and prediction.heat is not None:
            metrics["heatmap"] = heatmap_loss(prediction.heat, batch)
            total += config.heatmap_weight * metrics["heatmap"]
        return total, {"loss": total, **metrics}

    def act(params: Params, obs: Obs, key: Key) -> jax.Array:
        del key  # ACT acts with its latent at zero: nothing is drawn.
        predicted = network(params)(obs, proprio(obs)).outputs[..., : spec.action_dim]
        return action_scale.raw(predicted)

    return Policy(init, loss, act, config, spec, min(config.execute or spec.chunk, spec.chunk))


FAMILY = Family(ActConfig, ACT_PRESETS, make_act, with_conditioning)
