"""Image encoders: the paper's ResNet-18 and ray encoder, and a small one for a laptop."""

import math
from collections.abc import Callable
from itertools import pairwise

import jax
import jax.numpy as jnp
from flax import nnx
from jax.typing import DTypeLike

from jaxcam.models.layers import HE_FAN_OUT, TORCH, conv, group_norm, layer_norm, linear

FROZEN_SCALE = 1 / math.sqrt(1 + 1e-5)
"""A frozen batch norm whose statistics were never set: mean 0, variance 1, no learned affine."""

NORMS = ("identity", "frozen", "group")
Norm = Callable[[jax.Array], jax.Array]


def identity_norm(x: jax.Array) -> jax.Array:
    """A frozen batch norm that was never given statistics."""
    return x * FROZEN_SCALE


class FrozenNorm(nnx.Module):
    """A frozen batch norm: weight and statistics folded to a scale and a bias nobody trains."""

    def __init__(self, width: int, *, dtype: DTypeLike):
        self.frozen_scale = nnx.Param(jnp.full(width, FROZEN_SCALE))
        self.frozen_bias = nnx.Param(jnp.zeros(width))
        self.dtype = dtype

    def __call__(self, x: jax.Array) -> jax.Array:
        """Map [..., width] to [..., width]."""
        scale, bias = (
            jax.lax.stop_gradient(p[...]).astype(self.dtype)
            for p in (self.frozen_scale, self.frozen_bias)
        )
        return x * scale + bias


def make_norm(kind: str, width: int, *, rngs: nnx.Rngs, dtype: DTypeLike) -> Norm:
    """A norm of `NORMS`: frozen without or with statistics, or in groups of 16 channels."""
    if kind == "group":
        return group_norm(width, max(1, width // 16), rngs=rngs, dtype=dtype)
    return FrozenNorm(width, dtype=dtype) if kind == "frozen" else identity_norm


def max_pool(x: jax.Array) -> jax.Array:
    """3×3 maximum with stride 2, padded by -inf.

    It is written as maxima of slices: XLA's gradient of windows takes a CPU three times as long.
    """
    for axis in (1, 2):
        pads = [(1, 1) if i == axis else (0, 0) for i in range(4)]
        padded, size = jnp.pad(x, pads, constant_values=-jnp.inf), x.shape[axis]
        a, b, c = (jax.lax.slice_in_dim(padded, i, i + size, stride=2, axis=axis) for i in range(3))
        x = jnp.maximum(jnp.maximum(a, b), c)
    return x


class BasicBlock(nnx.Module):
    """Two 3×3 convolutions and a shortcut."""

    def __init__(
        self, d_in: int, d_out: int, stride: int, norm: str, *, rngs: nnx.Rngs, dtype: DTypeLike
    ):
        def layer(d_in: int, size: int, stride: int) -> nnx.Conv:
            return conv(d_in, d_out, size, stride, rngs=rngs, dtype=dtype, kernel_init=HE_FAN_OUT)

        same = stride == 1 and d_in == d_out
        self.conv1 = layer(d_in, 3, stride)
        self.norm1 = make_norm(norm, d_out, rngs=rngs, dtype=dtype)
        self.conv2 = layer(d_out, 3, 1)
        self.norm2 = make_norm(norm, d_out, rngs=rngs, dtype=dtype)
        self.shortcut = None if same else layer(d_in, 1, stride)
        self.shortcut_norm = None if same else make_norm(norm, d_out, rngs=rngs, dtype=dtype)

    def __call__(self, x: jax.Array) -> jax.Array:
        """Map [N, H, W, d_in] to [N, H/stride, W/stride, d_out]."""
        y = jax.nn.relu(self.norm1(self.conv1(x)))
        y = self.norm2(self.conv2(y))
        if self.shortcut is not None and self.shortcut_norm is not None:
            x = self.shortcut_norm(self.shortcut(x))
        return jax.nn.relu(x + y)


class ResNet18(nnx.Module):
    """ResNet-18 up to its last feature map: stride 32, 512 channels, norms of one of `NORMS`.

    With more than three input channels the first convolution starts from PyTorch's default, as in
    the paper's early fusion, instead of ResNet's own.
    """

    stride = 32
    channels = 512

    def __init__(self, d_in: int, norm: str, *, rngs: nnx.Rngs, dtype: DTypeLike):
        stem_init = HE_FAN_OUT if d_in == 3 else TORCH
        self.stem = conv(d_in, 64, 7, 2, rngs=rngs, dtype=dtype, kernel_init=stem_init)
        self.norm = make_norm(norm, 64, rngs=rngs, dtype=dtype)
        self.blocks = nnx.List(
            BasicBlock(d_from, d_to, stride, norm, rngs=rngs, dtype=dtype)
            for d_first, d_to, first_stride in (
                (64, 64, 1),
                (64, 128, 2),
                (128, 256, 2),
                (256, 512, 2),
            )
            for d_from, stride in ((d_first, first_stride), (d_to, 1))
        )

    def __call__(self, x: jax.Array, rays: jax.Array | None = None) -> jax.Array:
        """Map images [N, H, W, 3], joined by a ray-map of their size, to [N, H/32, W/32, 512]."""
        if rays is not None:
            x = jnp.concatenate([x, rays], -1)
        x = max_pool(jax.nn.relu(self.norm(self.stem(x))))
        for block in self.blocks:
            x = block(x)
        return x


class RayEncoder(nnx.Module):
    """The paper's ray-map encoder: five strided convolutions to the ResNet's grid and width."""

    def __init__(self, *, rngs: nnx.Rngs, dtype: DTypeLike):
        widths = (6, 64, 128, 256, 512, 512)
        self.convs = nnx.List(
            conv(d_in, d_out, 7 if d_in == 6 else 3, 2, rngs=rngs, dtype=dtype)
            for d_in, d_out in pairwise(widths)
        )

    def __call__(self, x: jax.Array) -> jax.Array:
        """Map [N, H, W, 6] to [N, H/32, W/32, 512]."""
        for layer in self.convs:
            x = jax.nn.relu(identity_norm(layer(x)))
        return x


def space_to_depth(x: jax.Array, size: int) -> jax.Array:
    """Fold ``size`` × ``size`` neighbourhoods of [N, H, W, C] into channels."""
    n, h, w, c = x.shape
    x = x.reshape(n, h // size, size, w // size, size, c).transpose(0, 1, 3, 2, 4, 5)
    return x.reshape(n, h // size, w // size, size * size * c)


class SmallEncoder(nnx.Module):
    """A stride-4 encoder that a CPU trains quickly.

    XLA's CPU gradients of strided convolutions are slow: so pixels are folded into channels once,
    and everything after that has stride 1. A layer norm costs as much as a convolution; there is
    one, at the end.
    """

    stride = 4

    def __init__(self, d_rays: int, width: int, depth: int, *, rngs: nnx.Rngs, dtype: DTypeLike):
        self.stem = conv(3 * self.stride**2 + d_rays, width, 3, rngs=rngs, dtype=dtype, bias=True)
        self.convs = nnx.List(
            conv(width, width, 3, rngs=rngs, dtype=dtype, bias=True) for _ in range(depth)
        )
        self.norm = layer_norm(width, rngs=rngs, dtype=dtype)

    def __call__(self, x: jax.Array, rays: jax.Array | None = None) -> jax.Array:
        """Map images [N, H, W, 3], joined by rays [N, H/4, W/4, 6], to [N, H/4, W/4, width]."""
        x = space_to_depth(x, self.stride)
        if rays is not None:
            x = jnp.concatenate([x, rays], -1)
        x = self.stem(x)
        for layer in self.convs:
            x = x + layer(jax.nn.relu(x))
        return jax.nn.relu(self.norm(x))


class SmallRayEncoder(nnx.Module):
    """A perceptron applied to every ray of the grid: ray-maps are too smooth to need a window."""

    def __init__(self, width: int, *, rngs: nnx.Rngs, dtype: DTypeLike):
        self.layers = nnx.List(linear(d_in, width, rngs=rngs, dtype=dtype) for d_in in (6, width))

    def __call__(self, x: jax.Array) -> jax.Array:
        """Map [N, h, w, 6] to [N, h, w, width]."""
        for layer in self.layers:
            x = jax.nn.relu(layer(x))
        return x
