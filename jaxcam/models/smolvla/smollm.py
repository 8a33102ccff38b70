"""SmolLM2's transformer layer: RMS norms, grouped queries, rotary positions, a gated perceptron.

The language model of SmolVLA and its action expert are both stacks of it.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jax.nn.initializers import Initializer, normal
from jax.typing import DTypeLike

from jaxcam.models.layers import TORCH
from jaxcam.models.token_frames import TokenFrames
from jaxcam.rays.rotations import Array, array_namespace

WAVELENGTH = 10_000.0
"""Longest wavelength of the rotary positions over 2 pi. SmolVLA was trained with this one, although
the configuration of the language model it starts from says 100,000."""


NORMAL = normal(0.02)
"""How the layers of SmolVLM2 start."""


class KeyValue(NamedTuple):
    """What later tokens attend to: rotated keys and values, each [B, N, kv_heads, head_dim]."""

    key: jax.Array
    value: jax.Array

    def framed(self, framing: TokenFrames | None) -> "KeyValue":
        """As they are read from the base's frame; as they are without frames."""
        return self if framing is None else KeyValue(*map(framing.read, self))


def dense(
    d_in: int,
    d_out: int,
    *,
    bias: bool = False,
    init: Initializer = NORMAL,
    rngs: nnx.Rngs,
    dtype: DTypeLike,
) -> nnx.Linear:
    """A dense layer as language models have it: usually without a bias, which else starts at 0."""
    return nnx.Linear(d_in, d_out, use_bias=bias, kernel_init=init, dtype=dtype, rngs=rngs)


def rms_norm(width: int, *, rngs: nnx.Rngs, dtype: DTypeLike) -> nnx.RMSNorm:
    """Root-mean-square normalisation; the statistics are float32 whatever ``dtype`` is."""
    return nnx.RMSNorm(width, epsilon=1e-5, dtype=dtype, use_fast_variance=False, rngs=rngs)


def rope(x: jax.Array, positions: Array) -> jax.Array:
    """Rotate queries or keys by their positions, first half of the channels against the second.

    Args:
        x: [B, N, heads, head_dim].
        positions: Position of every token, [N] or [B, N].
    """
    half, xp = x.shape[-1] // 2, array_namespace(positions)
    angle = positions[..., None] / WAVELENGTH ** (np.arange(half) / half)
    sin, cos = (f(angle)[..., None, :].astype(np.float32) for f in (xp.sin, xp.cos))
    a, b = jnp.split(x.astype(jnp.float32), 2, -1)
    return jnp.concatenate([a * cos - b * sin, b * cos + a * sin], -1).astype(x.dtype)


class Layer(nnx.Module):
    """One layer. Attention is left to the caller, since layers may share theirs.

    Args:
        width: Numbers a token.
        hidden: Hidden width of the gated perceptron.
        heads: Query heads.
        kv_heads: Key and value heads; each serves ``heads / kv_heads`` queries.
        head_dim: Numbers a head.
        d_context: Width of what keys and values are made from, if that is not the tokens.
    """

    def __init__(
        self,
        width: int,
        hidden: int,
        heads: int,
        kv_heads: int,
        head_dim: int,
        *,
        d_context: int | None = None,
        rngs: nnx.Rngs,
        dtype: DTypeLike,
    ):
        def layer(d_in: int, d_out: int, init: Initializer = NORMAL) -> nnx.Linear:
            return dense(d_in, d_out, init=init, rngs=rngs, dtype=dtype)

        self.head_dim = head_dim
        d_kv, init = (width, NORMAL) if d_context is None else (d_context, TORCH)
        self.norm1 = rms_norm(width, rngs=rngs, dtype=dtype)
        self.query = layer(width, heads * head_dim)
        self.key = layer(d_kv, kv_heads * head_dim, init)
        self.value = layer(d_kv, kv_heads * head_dim, init)
        self.out = layer(heads * head_dim, width)
        self.norm2 = rms_norm(width, rngs=rngs, dtype=dtype)
        self.gate, self.up = layer(width, hidden), layer(width, hidden)
        self.down = layer(hidden, width)

    def queries(self, normed: jax.Array, positions: Array) -> jax.Array:
        """Rotated queries [B, N, heads, head_dim] of normalised tokens."""
        return rope(self._heads(self.query(normed)), positions)

    def keys_values(self, normed: jax.Array, positions: Array) -> KeyValue:
        """Rotated keys, and values, of normalised tokens."""
        key, value = self._heads(self.key(normed)), self._heads(self.value(normed))
        return KeyValue(rope(key, positions), value)

    def read(self, context: KeyValue) -> KeyValue:
        """Keys and values of this layer, made from those of another one."""
        key, value = (x.reshape(*x.shape[:2], -1) for x in context)
        return KeyValue(self._heads(self.key(key)), self._heads(self.value(value)))

    def attend(
        self,
        x: jax.Array,
        query: jax.Array,
        context: KeyValue,
        mask: Array | None,
        framing: TokenFrames | None = None,
    ) -> jax.Array:
        """Tokens after attention and perceptron.

        Args:
            x: Tokens [B, N, width].
            query: Their rotated queries.
            context: What they attend to.
            mask: Where they may, [N, M] or [B, N, M]; None is everywhere.
            framing: Of the tokens; those of what they attend to are in it already.
        """
        keep = None if mask is None else mask.reshape(-1, 1, *mask.shape[-2:])
        query = query if framing is None else framing.query(query)
        mixed = jax.nn.dot_product_attention(query, context.key, context.value, mask=keep)
        mixed = mixed if framing is None else framing.output(mixed)
        x = x + self.out(mixed.reshape(*mixed.shape[:2], -1))
        y = self.norm2(x)
        return x + self.down(jax.nn.silu(self.gate(y)) * self.up(y))

    def _heads(self, x: jax.Array) -> jax.Array:
        return x.reshape(*x.shape[:-1], -1, self.head_dim)
