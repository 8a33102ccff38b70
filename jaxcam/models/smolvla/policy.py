"""SmolVLA's three functions."""

import jax
import jax.numpy as jnp

from jaxcam.errors import ConfigError
from jaxcam.models.conditioning import with_conditioning
from jaxcam.models.losses import padded_mean, repeat_ends
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
from jaxcam.models.smolvla.config import SMOLVLA_PRESETS, SmolVlaConfig
from jaxcam.models.smolvla.flow import draw_time, integrate, line
from jaxcam.models.smolvla.network import PRETRAINED, SmolVla
from jaxcam.models.smolvla.prompt import NO_TOKENS, with_prompts


def velocity_loss(
    config: SmolVlaConfig,
    predicted: jax.Array,
    target: jax.Array,
    is_pad: jax.Array,
    action_dim: int,
) -> jax.Array:
    """Mean squared error of velocities [B, T, W], of which `action_dim` numbers are real."""
    error = jnp.square(predicted - target)
    if config.padding != "counted":
        error = error[..., :action_dim]
    return padded_mean(error, is_pad, config.padding)


def trained(params: Params) -> Params:
    """False at the parameters that training the expert leaves alone."""
    return {
        part: jax.tree.map(lambda _, is_trained=part not in PRETRAINED: is_trained, tree)
        for part, tree in params.items()
    }


def make_smolvla(config: SmolVlaConfig, spec: PolicySpec, stats: Stats) -> Policy:
    """Make SmolVLA's three functions; statistics become constants of them."""
    check_sizes(config.chunk, spec, stats)
    _check_fit(config, spec)
    action_scale, proprio_scale = action_deviation(stats), proprio_deviation(stats)
    init, network = pure(lambda rngs: SmolVla(config, spec, rngs=rngs))
    width = config.actions(spec)

    def state(obs: Obs) -> jax.Array:
        raw = jnp.zeros_like(obs["proprio"]) if config.drop_proprio else obs["proprio"]
        return _filled(proprio_scale.normalised(raw), config.state_width)

    def loss(params: Params, batch: Batch, key: Key) -> tuple[jax.Array, dict[str, jax.Array]]:
        if config.train == "expert":
            params = jax.tree.map(
                lambda p, t: p if t else jax.lax.stop_gradient(p), params, trained(params)
            )
        action, is_pad = action_scale.normalised(batch["action"]), batch["is_pad"]
        if config.padding != "valid":
            action = repeat_ends(action, is_pad)
        action = _filled(action, width)
        # Without a key, as in validation, noise and times are the same every time.
        noise_key, time_key = jax.random.split(jax.random.key(0) if key is None else key)
        noise = jax.random.normal(noise_key, action.shape)
        time = draw_time(time_key, action.shape[0])
        x, target = line(action, noise, time)
        net = network(params)
        prefix = net.prefix(batch, state(batch))
        predicted = net.velocity(prefix, x, time)
        total = velocity = velocity_loss(config, predicted, target, is_pad, spec.action_dim)
        if net.keyframe is None:
            return total, {"loss": total}
        keyframe = keyframe_deviation(stats).normalised(batch["keyframe"])
        answer = net.keyframe(prefix.summary.astype(jnp.float32)).reshape(keyframe.shape)
        error = padded_mean(jnp.abs(answer - keyframe), keyframe_padding(batch), "valid")
        total += config.keyframe_weight * error
        return total, {"loss": total, "velocity": velocity, "keyframe": error}

    def act(params: Params, obs: Obs, key: Key) -> jax.Array:
        net = network(params)
        prefix = net.prefix(obs, state(obs))
        shape = (obs["proprio"].shape[0], config.chunk, width)
        noise = jnp.zeros(shape) if key is None else jax.random.normal(key, shape)
        x = integrate(lambda x, time: net.velocity(prefix, x, time), noise, config.steps)
        return action_scale.raw(x[..., : spec.action_dim])

    execute = min(config.execute or spec.chunk, spec.chunk)
    only = trained if config.train == "expert" else None
    return Policy(init, loss, act, config, spec, execute, only)


def _filled(x: jax.Array, width: int) -> jax.Array:
    """The last axis filled up with zeros."""
    return jnp.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, width - x.shape[-1])])


def _check_fit(config: SmolVlaConfig, spec: PolicySpec) -> None:
    if not config.tokens:
        raise ConfigError(NO_TOKENS)
    if config.encoder == "siglip" and spec.height != spec.width:
        raise ConfigError(f"SmolVLA takes square images, got {spec.height}x{spec.width}.")
    if spec.proprio_dim > config.state_width:
        raise ConfigError(
            f"Proprioception has {spec.proprio_dim} numbers, SmolVLA takes {config.state_width}."
        )
    if config.action_width and spec.action_dim > config.action_width:
        raise ConfigError(
            f"Actions have {spec.action_dim} numbers, SmolVLA predicts {config.action_width}."
        )


FAMILY = Family(SmolVlaConfig, SMOLVLA_PRESETS, make_smolvla, with_conditioning, with_prompts)
