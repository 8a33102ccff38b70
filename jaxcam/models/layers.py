"""Layers that start and compute as the PyTorch models do which the paper's numbers come from."""

import math
from typing import Any

import jax
import jax.numpy as jnp
from flax import nnx
from jax.nn.initializers import Initializer, variance_scaling
from jax.typing import DTypeLike

from jaxcam.models.convolution import convolve
from jaxcam.models.policy import Key

TORCH = variance_scaling(1 / 3, "fan_in", "uniform")
"""PyTorch's default for linear and convolution weights: uniform within 1/sqrt(fan_in)."""

XAVIER = variance_scaling(1.0, "fan_avg", "uniform")

PACKED_XAVIER = variance_scaling(0.5, "fan_in", "uniform")
"""Xavier's bound for query, key and value weights packed in one [3E, E] matrix, as PyTorch does."""

HE_FAN_OUT = variance_scaling(2.0, "fan_out", "normal")


def uniform_bias(fan_in: int) -> Initializer:
    """PyTorch's default bias, uniform within 1/sqrt(fan_in)."""
    bound = 1 / math.sqrt(fan_in)

    def init(key: jax.Array, shape: Any, dtype: Any = None, out_sharding: Any = None) -> jax.Array:
        del out_sharding
        return jax.random.uniform(key, shape, dtype or jnp.float32, -bound, bound)

    return init


def linear(
    d_in: int,
    d_out: int,
    *,
    rngs: nnx.Rngs,
    dtype: DTypeLike,
    kernel_init: Initializer = TORCH,
    bias_init: Initializer | None = None,
) -> nnx.Linear:
    """A dense layer over the last axis; on a feature map it is the 1×1 convolution."""
    bias_init = bias_init or uniform_bias(d_in)
    return nnx.Linear(
        d_in, d_out, dtype=dtype, kernel_init=kernel_init, bias_init=bias_init, rngs=rngs
    )


def conv(
    d_in: int,
    d_out: int,
    size: int,
    stride: int = 1,
    *,
    rngs: nnx.Rngs,
    dtype: DTypeLike,
    bias: bool = False,
    kernel_init: Initializer = TORCH,
) -> nnx.Conv:
    """A convolution with explicit symmetric padding (``SAME`` pads even sizes unevenly)."""
    pad = (size - 1) // 2
    return nnx.Conv(
        d_in,
        d_out,
        (size, size),
        strides=stride,
        padding=((pad, pad), (pad, pad)),
        use_bias=bias,
        dtype=dtype,
        kernel_init=kernel_init,
        bias_init=uniform_bias(d_in * size * size),
        conv_general_dilated=convolve,
        rngs=rngs,
    )


def layer_norm(width: int, *, rngs: nnx.Rngs, dtype: DTypeLike) -> nnx.LayerNorm:
    """Layer normalisation with PyTorch's epsilon; statistics are float32 whatever ``dtype`` is."""
    return nnx.LayerNorm(width, epsilon=1e-5, dtype=dtype, use_fast_variance=False, rngs=rngs)


def group_norm(width: int, groups: int, *, rngs: nnx.Rngs, dtype: DTypeLike) -> nnx.GroupNorm:
    """Group normalisation with PyTorch's epsilon; statistics are float32 whatever ``dtype`` is."""
    return nnx.GroupNorm(
        width, num_groups=groups, epsilon=1e-5, dtype=dtype, use_fast_variance=False, rngs=rngs
    )


def dropout(x: jax.Array, rate: float, key: Key) -> jax.Array:
    """Dropout that is off without a key.

    Numbers of 16 bits decide, which cost half of what floats do; the rate is the nearest they have.
    """
    if key is None or rate == 0.0:
        return x
    levels = 2**16
    dropped = round(rate * levels)
    keep = jax.random.bits(key, x.shape, jnp.uint16) >= dropped
    return jnp.where(keep, x * (levels / (levels - dropped)), 0)


def split_key(key: Key, count: int) -> list[Key]:
    """``jax.random.split`` for a key that may be ``None``."""
    return [None] * count if key is None else list(jax.random.split(key, count))
