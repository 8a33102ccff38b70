"""Noise schedule and samplers of diffusion, number for number those of the diffusers library.

A sampler is a table with one row a step and one scan that follows it: every step estimates the
clean sample, clips it to -1..1, and mixes it with the noisy sample, the predicted noise and, in
DDPM, fresh noise. Public source: diffusers 0.35, `DDPMScheduler` and `DDIMScheduler` with
`squaredcos_cap_v2`, predicted noise, clipped samples and leading time steps.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

SAMPLERS = ("ddpm", "ddim")
MAX_BETA = 0.999
LEAST_VARIANCE = 1e-20


class StepTable(NamedTuple):
    """What a sampler does, each [steps]: next = clean * x0 + noisy * x + predicted * e + fresh * n.

    The estimate of the clean sample is x0 = clip((x - noise_share * e) / clean_share).
    """

    t: Any
    clean_share: Any
    noise_share: Any
    clean: Any
    noisy: Any
    predicted: Any
    fresh: Any


def cosine_alphas(steps: int) -> np.ndarray:
    """Share of the clean sample's variance that is left after each noising step, float32."""

    def level(u: np.ndarray) -> np.ndarray:
        return np.cos((u + 0.008) / 1.008 * np.pi / 2) ** 2

    u = np.arange(steps)
    betas = np.minimum(1 - level((u + 1) / steps) / level(u / steps), MAX_BETA)
    return np.cumprod(np.float32(1) - betas.astype(np.float32), dtype=np.float32)


def add_noise(alphas: np.ndarray, x: jax.Array, noise: jax.Array, t: jax.Array) -> jax.Array:
    """Noisy samples.

    Args:
        alphas: From `cosine_alphas`.
        x: Clean samples [B, ...].
        noise: Standard normal, of the same shape.
        t: Noising step of every sample [B].
    """
    share = jnp.asarray(alphas)[t].reshape(-1, *(1,) * (x.ndim - 1))
    return jnp.sqrt(share) * x + jnp.sqrt(1 - share) * noise


def make_table(sampler: str, alphas: np.ndarray, steps: int) -> StepTable:
    """The table of a sampler.

    Args:
        sampler: `ddpm`, or `ddim` (without fresh noise).
        alphas: From `cosine_alphas`.
        steps: Denoising steps, at most as many as there are noising steps.
    """
    stride = len(alphas) // steps
    t = np.arange(steps)[::-1] * stride
    before = t - stride
    one = np.float32(1)
    now = alphas[t]
    then = np.where(before >= 0, alphas[before], one)
    zero = np.zeros(steps, np.float32)
    if sampler == "ddim":
        mixed = {"clean": np.sqrt(then), "noisy": zero, "predicted": np.sqrt(one - then)}
        return StepTable(t, np.sqrt(now), np.sqrt(one - now), **mixed, fresh=zero)
    ratio = now / then
    variance = np.maximum((one - then) / (one - now) * (one - ratio), LEAST_VARIANCE)
    return StepTable(
        t,
        np.sqrt(now),
        np.sqrt(one - now),
        clean=np.sqrt(then) * (one - ratio) / (one - now),
        noisy=np.sqrt(ratio) * (one - then) / (one - now),
        predicted=zero,
        fresh=np.where(t > 0, np.sqrt(variance), 0).astype(np.float32),
    )


def sample(
    table: StepTable,
    predict: Callable[[jax.Array, jax.Array], jax.Array],
    x: jax.Array,
    noise: jax.Array | None = None,
) -> jax.Array:
    """Denoise.

    Args:
        table: From `make_table`.
        predict: Noise in samples [B, ...] at the noising step t, a scalar.
        x: Pure noise [B, ...].
        noise: Fresh noise of every step [steps, B, ...]; without it none is added.
    """

    def step(x: jax.Array, now: tuple[StepTable, jax.Array | None]) -> tuple[jax.Array, None]:
        row, fresh = now
        predicted = predict(x, row.t)
        clean = jnp.clip((x - row.noise_share * predicted) / row.clean_share, -1, 1)
        x = row.clean * clean + row.noisy * x + row.predicted * predicted
        return x if fresh is None else x + row.fresh * fresh, None

    return jax.lax.scan(step, x, (jax.tree.map(jnp.asarray, table), noise))[0]
