"""Means over chunks of which some steps are padding: the rules that public code follows."""

import jax
import jax.numpy as jnp

PADDINGS = ("counted", "zeroed", "valid", "sample")


def padded_mean(error: jax.Array, is_pad: jax.Array, rule: str) -> jax.Array:
    """Mean of errors.

    Args:
        error: Of every step and dimension [B, T, D].
        is_pad: Where steps are padding [B, T].
        rule: ``counted``: like any other step (Diffusion Policy). ``zeroed``: as zeros that count
            in the mean (ACT; LeRobot 0.4). ``valid``: not at all (later LeRobot). ``sample``: not
            at all, and every sample weighs the same (the paper's Diffusion Policy).

    Returns:
        A scalar.
    """
    if rule == "counted":
        return jnp.mean(error)
    keep = ~is_pad[..., None]
    if rule == "zeroed":
        return jnp.mean(error * keep)
    error = jnp.where(keep, error, 0).mean(-1)
    steps = (~is_pad).sum(-1)
    if rule == "valid":
        return error.sum() / jnp.maximum(steps.sum(), 1)
    return (error.sum(-1) / jnp.maximum(steps, 1)).mean()


def repeat_ends(x: jax.Array, is_pad: jax.Array) -> jax.Array:
    """Chunks [B, T, D] whose padded steps copy the last one before that is not, or the first."""
    place = jnp.arange(x.shape[1])
    index = jax.lax.cummax(jnp.where(is_pad, -1, place), axis=1)
    index = jnp.where(index < 0, jnp.argmin(is_pad, 1, keepdims=True), index)
    return jnp.take_along_axis(x, index[..., None], 1)
