"""The 1-D U-Net of Diffusion Policy: a chunk of noisy actions and a condition to their noise.

Convolutions over time are written as matrix products on unfolded windows. Chunks are so short that
the copies are small, and on CPUs XLA runs convolutions in loops, such as a sampler's, many times
slower than products. Public source: the Diffusion Policy repository, and LeRobot's port of it.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jax.typing import DTypeLike

from jaxcam.models.layers import TORCH, group_norm, linear, uniform_bias


class Conv1d(nnx.Module):
    """A convolution over the middle axis of [B, T, C], padded by half its size."""

    def __init__(
        self,
        d_in: int,
        d_out: int,
        size: int,
        stride: int = 1,
        *,
        rngs: nnx.Rngs,
        dtype: DTypeLike,
    ):
        self.kernel = nnx.Param(TORCH(rngs.params(), (size, d_in, d_out)))
        self.bias = nnx.Param(uniform_bias(d_in * size)(rngs.params(), (d_out,)))
        self.size, self.stride, self.dtype = size, stride, dtype

    def __call__(self, x: jax.Array) -> jax.Array:
        """Map [B, T, d_in] to [B, T / stride, d_out]."""
        kernel, bias = self.kernel[...].astype(self.dtype), self.bias[...].astype(self.dtype)
        half = self.size // 2
        padded = jnp.pad(x, ((0, 0), (half, half), (0, 0)))
        length = x.shape[1]
        windows = [padded[:, i : i + length : self.stride] for i in range(self.size)]
        windows = jnp.concatenate(windows, -1).astype(self.dtype)
        return windows @ kernel.reshape(-1, kernel.shape[-1]) + bias


class Upsample(nnx.Module):
    """The transposed convolution of size 4 and stride 2 over the middle axis of [B, T, C].

    Every second result sees the same two parts of the kernel, so it is two products. As PyTorch's,
    the kernel lists inputs last.
    """

    def __init__(self, width: int, *, rngs: nnx.Rngs, dtype: DTypeLike):
        self.kernel = nnx.Param(TORCH(rngs.params(), (4, width, width)))
        self.bias = nnx.Param(uniform_bias(4 * width)(rngs.params(), (width,)))
        self.dtype = dtype

    def __call__(self, x: jax.Array) -> jax.Array:
        """Map [B, T, C] to [B, 2 T, C]."""
        kernel, bias = self.kernel[...].astype(self.dtype), self.bias[...].astype(self.dtype)
        padded = jnp.pad(x.astype(self.dtype), ((0, 0), (1, 1), (0, 0)))
        before, after = padded[:, :-2], padded[:, 2:]
        even = x @ kernel[1].T + before @ kernel[3].T
        odd = x @ kernel[2].T + after @ kernel[0].T
        return jnp.stack([even, odd], 2).reshape(x.shape[0], -1, x.shape[-1]) + bias


def mish(x: jax.Array) -> jax.Array:
    """Mish, x tanh(log(1 + e^x)), written with one exponential: cheaper to compile and to run."""
    e = jnp.exp(jnp.minimum(x, 20.0))  # beyond which it is x
    n = e * (e + 2)
    return x * n / (n + 2)


class ConvBlock(nnx.Module):
    """Convolution, group norm, Mish."""

    def __init__(
        self, d_in: int, d_out: int, size: int, groups: int, *, rngs: nnx.Rngs, dtype: DTypeLike
    ):
        self.conv = Conv1d(d_in, d_out, size, rngs=rngs, dtype=dtype)
        self.norm = group_norm(d_out, groups, rngs=rngs, dtype=dtype)

    def __call__(self, x: jax.Array) -> jax.Array:
        """Map [B, T, d_in] to [B, T, d_out]."""
        return mish(self.norm(self.conv(x)))


class ResidualBlock(nnx.Module):
    """Two convolution blocks, scaled and shifted by the condition in between, and a shortcut."""

    def __init__(
        self,
        d_in: int,
        d_out: int,
        d_condition: int,
        size: int,
        groups: int,
        *,
        rngs: nnx.Rngs,
        dtype: DTypeLike,
    ):
        self.block1 = ConvBlock(d_in, d_out, size, groups, rngs=rngs, dtype=dtype)
        self.film = linear(d_condition, 2 * d_out, rngs=rngs, dtype=dtype)
        self.block2 = ConvBlock(d_out, d_out, size, groups, rngs=rngs, dtype=dtype)
        same = d_in == d_out
        self.shortcut = None if same else Conv1d(d_in, d_out, 1, rngs=rngs, dtype=dtype)

    def __call__(self, x: jax.Array, condition: jax.Array) -> jax.Array:
        """Map [B, T, d_in] and the activated condition [B, d_condition] to [B, T, d_out]."""
        scale, shift = jnp.split(self.film(condition)[:, None], 2, -1)
        y = self.block2(scale * self.block1(x) + shift)
        return y + (x if self.shortcut is None else self.shortcut(x))


class Stage(nnx.Module):
    """Two residual blocks of one width."""

    def __init__(self, d_in: int, d_out: int, *sizes: int, rngs: nnx.Rngs, dtype: DTypeLike):
        self.block1 = ResidualBlock(d_in, d_out, *sizes, rngs=rngs, dtype=dtype)
        self.block2 = ResidualBlock(d_out, d_out, *sizes, rngs=rngs, dtype=dtype)

    def __call__(
        self, x: jax.Array, condition: jax.Array, between: jax.Array | None = None
    ) -> jax.Array:
        """Map [B, T, d_in] to [B, T, d_out]; ``between`` is added between the blocks."""
        x = self.block1(x, condition)
        return self.block2(x if between is None else x + between, condition)


def step_embedding(t: jax.Array, width: int) -> jax.Array:
    """Sines, then cosines, of noising steps: [B] to [B, width]."""
    half = width // 2
    frequency = np.exp(np.arange(half) * (-np.log(10000) / (half - 1))).astype(np.float32)
    angle = t.astype(jnp.float32)[:, None] * frequency
    return jnp.concatenate([jnp.sin(angle), jnp.cos(angle)], -1)


@dataclass(frozen=True)
class UNetConfig:
    """Sizes of the U-Net."""

    channels: tuple[int, ...]
    """Width of every stage; each stage but the last halves the chunk's length."""
    kernel: int
    """Steps that a convolution sees."""
    groups: int
    """Groups of the norms."""
    last_groups: int
    """Groups of the last one."""
    step_width: int
    """Width of the noising step's embedding."""


class UNet(nnx.Module):
    """Noise in a chunk of actions.

    Args:
        config: Sizes.
        d_action: Dimensions of an action.
        d_global: Numbers that condition the chunk as a whole.
        d_local: Numbers that condition every step of it; 0 builds no such branch.
        rngs: Where weights are drawn from.
        dtype: Type of the arithmetic.
    """

    def __init__(
        self,
        config: UNetConfig,
        d_action: int,
        d_global: int,
        d_local: int,
        *,
        rngs: nnx.Rngs,
        dtype: DTypeLike,
    ):
        channels, d_step = config.channels, config.step_width
        sizes = (d_step + d_global, config.kernel, config.groups)
        first = channels[0]

        def stages(pairs: Iterable[tuple[int, int]]) -> nnx.List:
            return nnx.List(Stage(a, b, *sizes, rngs=rngs, dtype=dtype) for a, b in pairs)

        self.d_step, self.dtype = d_step, dtype
        self.step1 = linear(d_step, 4 * d_step, rngs=rngs, dtype=dtype)
        self.step2 = linear(4 * d_step, d_step, rngs=rngs, dtype=dtype)
        self.local = nnx.List(
            ResidualBlock(d_local, first, *sizes, rngs=rngs, dtype=dtype)
            for _ in range(2 * (d_local > 0))
        )
        self.down = stages(pairwise((d_action, *channels)))
        self.shrink = nnx.List(Conv1d(c, c, 3, 2, rngs=rngs, dtype=dtype) for c in channels[:-1])
        self.middle = Stage(channels[-1], channels[-1], *sizes, rngs=rngs, dtype=dtype)
        self.up = stages((2 * a, b) for a, b in pairwise(channels[::-1]))
        self.grow = nnx.List(Upsample(c, rngs=rngs, dtype=dtype) for c in channels[-2::-1])
        last = config.last_groups
        self.last = ConvBlock(first, first, config.kernel, last, rngs=rngs, dtype=dtype)
        self.out = Conv1d(first, d_action, 1, rngs=rngs, dtype=dtype)

    def __call__(
        self, x: jax.Array, t: jax.Array, condition: jax.Array, local: jax.Array
    ) -> jax.Array:
        """Predict noise.

        Args:
            x: Noisy actions [B, T, A].
            t: Noising steps [B].
            condition: [B, d_global].
            local: [B, d_local]: the same for every step of the chunk.

        Returns:
            Noise [B, T, A], float32.
        """
        step = self.step2(mish(self.step1(step_embedding(t, self.d_step))))
        condition = mish(jnp.concatenate([step, condition.astype(self.dtype)], -1))
        local = jnp.broadcast_to(local[:, None], (*x.shape[:2], local.shape[-1]))
        early, late = [block(local, condition) for block in self.local] or (None, None)
        skips: list[jax.Array] = []
        for i, stage in enumerate(self.down):
            x = stage(x, condition, early if i == 0 else None)
            skips.append(x)
            if i < len(self.shrink):
                x = self.shrink[i](x)
        x = self.middle(x, condition)
        # As many stages go up as go down but one: what the first one saw is never used.
        for stage, grow, skip in zip(self.up, self.grow, skips[:0:-1], strict=True):
            x = grow(stage(jnp.concatenate([x, skip], -1), condition))
        return self.out(self.last(x if late is None else x + late)).astype(jnp.float32)
