"""Flow matching as SmolVLA does it: from noise (time 1) to actions (time 0) on straight lines."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

SHORTEST, LONGEST = 4e-3, 4.0
"""Shortest and longest period of the time embedding."""


def time_embedding(time: jax.Array, width: int) -> jax.Array:
    """Sines, then cosines, of a time at geometrically spaced periods.

    Args:
        time: Times in 0..1, float32 [B].
        width: Even number of channels.

    Returns:
        Float32 [B, width]. The fastest channel turns 250 times, so plain float32 phases would be
        wrong in the fourth digit; here time and frequency are split into a coarse part, whose
        product is exact, and a small rest.
    """
    periods = SHORTEST * (LONGEST / SHORTEST) ** np.linspace(0.0, 1.0, width // 2)
    frequency = 1 / periods
    mantissa, exponent = np.frexp(frequency)
    coarse = np.ldexp(np.round(mantissa * 2**11) / 2**11, exponent)
    rest = (frequency - coarse).astype(np.float32)
    coarse_time = jnp.floor(time * 2**12) / 2**12
    turns = coarse_time[:, None] * coarse.astype(np.float32)
    turns = turns - jnp.floor(turns)
    turns += coarse_time[:, None] * rest
    turns += (time - coarse_time)[:, None] * frequency.astype(np.float32)
    angle = 2 * np.pi * turns
    return jnp.concatenate([jnp.sin(angle), jnp.cos(angle)], -1)


def draw_time(key: jax.Array, batch: int) -> jax.Array:
    """Times to train at, float32 [B]: Beta(1.5, 1), moved to 0.001..1.

    The distribution function of Beta(1.5, 1) is t^1.5, so that its inverse is exact.
    """
    return jax.random.uniform(key, (batch,)) ** (2 / 3) * 0.999 + 0.001


def line(action: jax.Array, noise: jax.Array, time: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The point at a time of the line from actions to noise, and the line's velocity.

    Args:
        action: [B, T, A].
        noise: Of the same shape.
        time: [B].
    """
    t = time[:, None, None]
    return t * noise + (1 - t) * action, noise - action


def integrate(
    velocity: Callable[[jax.Array, jax.Array], jax.Array], noise: jax.Array, steps: int
) -> jax.Array:
    """Follow a velocity field from noise to actions by Euler's method.

    Args:
        velocity: ``velocity(x, time)`` at points [B, T, A] and times [B].
        noise: Where to start, [B, T, A].
        steps: Number of steps; the field is asked at times 1, 1 - 1/steps, ..., 1/steps.
    """

    def step(x: jax.Array, time: jax.Array) -> tuple[jax.Array, None]:
        return x - velocity(x, jnp.full(x.shape[0], time)) / steps, None

    times = (1 - np.arange(steps) / steps).astype(np.float32)
    return jax.lax.scan(step, noise, jnp.asarray(times))[0]
