"""Diffusion Policy's three functions."""

import jax
import jax.numpy as jnp

from jaxcam.errors import ConfigError
from jaxcam.models.conditioning import with_conditioning
from jaxcam.models.crops import window
from jaxcam.models.diffusion.config import DIFFUSION_PRESETS, DiffusionConfig
from jaxcam.models.diffusion.network import Diffusion
from jaxcam.models.losses import padded_mean, repeat_ends
from jaxcam.models.normalization import action_range, keyframe_deviation, proprio_range
from jaxcam.models.policy import (
    CAMERA_INPUTS,
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


def make_diffusion(config: DiffusionConfig, spec: PolicySpec, stats: Stats) -> Policy:
    """Make Diffusion Policy's three functions; statistics become constants of them."""
    check_sizes(config.chunk, spec, stats)
    if config.crop > min(spec.height, spec.width):
        raise ConfigError(
            f"A crop of {config.crop} pixels does not fit in {spec.height}x{spec.width}."
        )
    action_scale = action_range(stats, floors=config.floors)
    proprio_scale = proprio_range(stats, floors=config.floors)
    init, network = pure(lambda rngs: Diffusion(config, spec, rngs=rngs))
    chunk = (config.chunk, spec.action_dim)

    def condition(net: Diffusion, obs: Obs, key: Key) -> tuple[jax.Array, jax.Array]:
        names = (*CAMERA_INPUTS, "proprio")
        steps = {k: jnp.asarray(obs[k]) for k in names if k in obs}
        if config.obs_steps == 1:
            steps = {k: v[:, None] for k, v in steps.items()}
        if config.crop:
            steps |= window(steps, config.crop, key if config.crop_random else None)
        proprio = jnp.zeros_like(steps["proprio"]) if config.drop_proprio else steps["proprio"]
        return net.condition(steps, proprio_scale.normalised(proprio))

    def loss(params: Params, batch: Batch, key: Key) -> tuple[jax.Array, dict[str, jax.Array]]:
        # Without a key the draws are always the same, so that such losses can be compared.
        keys = jax.random.split(jax.random.key(0) if key is None else key, 3)
        net, is_pad = network(params), batch["is_pad"]
        conditions = condition(net, batch, None if key is None else keys[0])
        target = action_scale.normalised(batch["action"])
        if config.padding != "sample":
            target = repeat_ends(target, is_pad)
        t = jax.random.randint(keys[1], target.shape[:1], 0, config.noising_steps)
        noise = jax.random.normal(keys[2], target.shape)
        total = mse = net.noise_loss(target, is_pad, conditions, noise, t)
        metrics = {"mse": mse}
        if net.keyframe is not None:
            keyframe = keyframe_deviation(stats).normalised(batch["keyframe"])
            error = jnp.abs(net.keyframe(conditions[0]).reshape(keyframe.shape) - keyframe)
            metrics["keyframe"] = padded_mean(error, keyframe_padding(batch), "valid")
            total += config.keyframe_weight * metrics["keyframe"]
        return total, {"loss": total, **metrics}

    def act(params: Params, obs: Obs, key: Key) -> jax.Array:
        net, batch = network(params), len(obs["proprio"])
        x, fresh = jnp.zeros((batch, *chunk)), None
        if key is not None:
            first, later = jax.random.split(key)
            x = config.temperature * jax.random.normal(first, x.shape)
            if config.sampler == "ddpm":
                fresh = jax.random.normal(later, (config.sample_steps, *x.shape))
                fresh = config.temperature * fresh
        actions = net.denoise(condition(net, obs, None), x, fresh)
        return action_scale.raw(actions)[:, config.obs_steps - 1 :]

    ahead = config.chunk - config.obs_steps + 1
    return Policy(init, loss, act, config, spec, min(config.execute or ahead, ahead))


FAMILY = Family(DiffusionConfig, DIFFUSION_PRESETS, make_diffusion, with_conditioning)
