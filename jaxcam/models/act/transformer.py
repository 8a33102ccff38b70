"""Transformer layers in the DETR-style form of ACT.

Positions are added to queries and keys, never to values. Layer norms come before attention and
feed-forward layers (pre-norm, with one more norm at the end), as in the paper's ACT, or after the
sum with what they add to (post-norm), as in the original one.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jax.nn.initializers import zeros
from jax.typing import DTypeLike

from jaxcam.models.layers import (
    PACKED_XAVIER,
    TORCH,
    XAVIER,
    dropout,
    layer_norm,
    linear,
    split_key,
)
from jaxcam.models.policy import Key
from jaxcam.models.token_frames import TokenFrames


def sine_table(length: int, width: int) -> np.ndarray:
    """Sine positions [length, width]: even channels sine, odd channels cosine."""
    channel = np.arange(width)
    angle = np.arange(length)[:, None] / 10000 ** (2 * (channel // 2) / width)
    return np.where(channel % 2 == 0, np.sin(angle), np.cos(angle)).astype(np.float32)


def sine_grid(height: int, width: int, channels: int) -> np.ndarray:
    """Sine positions [height * width, channels] of an image's cells: rows first, then columns.

    Each is counted from 1 and scaled to end at 2 pi; even channels sine, odd channels cosine.
    """

    def axis(length: int) -> np.ndarray:
        channel = np.arange(channels // 2)
        place = np.arange(1, length + 1) / (length + 1e-6) * 2 * np.pi
        angle = place[:, None] / 10000 ** (2 * (channel // 2) / (channels // 2))
        return np.where(channel % 2 == 0, np.sin(angle), np.cos(angle))

    rows = np.repeat(axis(height), width, 0)
    return np.concatenate([rows, np.tile(axis(width), (height, 1))], -1).astype(np.float32)


@dataclass(frozen=True)
class LayerSizes:
    """What all layers of a transformer have in common."""

    width: int
    """Numbers a token."""
    heads: int
    """Attention heads."""
    hidden: int
    """Hidden width of the feed-forward layers."""
    dropout: float
    """Dropout rate in training."""
    pre_norm: bool
    """Whether norms come before the layers or after what these are added to."""


class Attention(nnx.Module):
    """Multi-head attention with dropout on the attention weights."""

    def __init__(self, sizes: LayerSizes, *, xavier: bool, rngs: nnx.Rngs, dtype: DTypeLike):
        width = sizes.width

        def packed() -> nnx.Linear:
            return linear(
                width, width, rngs=rngs, dtype=dtype, kernel_init=PACKED_XAVIER, bias_init=zeros
            )

        self.query, self.key, self.value = packed(), packed(), packed()
        self.out = linear(
            width,
            width,
            rngs=rngs,
            dtype=dtype,
            kernel_init=XAVIER if xavier else TORCH,
            bias_init=zeros,
        )
        self.heads = sizes.heads
        self.dropout_rate = sizes.dropout

    def __call__(
        self,
        q: jax.Array,
        k: jax.Array,
        v: jax.Array,
        *,
        key: Key,
        keep: jax.Array | None = None,
        framing: tuple[TokenFrames | None, TokenFrames | None] = (None, None),
    ) -> jax.Array:
        """Attend from ``q`` [B, N, D] to ``k``, ``v`` [B, M, D].

        ``keep`` [B, M] hides the rest; ``framing`` are the frames of the queries and of the keys.
        """
        asking, read = framing
        q, k, v = (
            layer(x).reshape(*x.shape[:-1], self.heads, -1)
            for layer, x in ((self.query, q), (self.key, k), (self.value, v))
        )
        q = q if asking is None else asking.query(q)
        k, v = (k, v) if read is None else (read.read(k), read.read(v))
        scores = jnp.einsum("bnhd,bmhd->bhnm", q, k, preferred_element_type=jnp.float32)
        scores = scores / np.sqrt(q.shape[-1])
        if keep is not None:
            scores = jnp.where(keep[:, None, None], scores, jnp.finfo(scores.dtype).min)
        weights = dropout(jax.nn.softmax(scores), self.dropout_rate, key).astype(v.dtype)
        mixed = jnp.einsum("bhnm,bmhd->bnhd", weights, v)
        mixed = mixed if asking is None else asking.output(mixed)
        return self.out(mixed.reshape(*mixed.shape[:-2], -1))


class FeedForward(nnx.Module):
    """The two-layer ReLU perceptron of a transformer layer."""

    def __init__(self, sizes: LayerSizes, *, xavier: bool, rngs: nnx.Rngs, dtype: DTypeLike):
        width, hidden, init = sizes.width, sizes.hidden, XAVIER if xavier else TORCH
        self.up = linear(width, hidden, rngs=rngs, dtype=dtype, kernel_init=init)
        self.down = linear(hidden, width, rngs=rngs, dtype=dtype, kernel_init=init)
        self.dropout_rate = sizes.dropout

    def __call__(self, x: jax.Array, *, key: Key) -> jax.Array:
        """Map [..., width] to [..., width]."""
        return self.down(dropout(jax.nn.relu(self.up(x)), self.dropout_rate, key))


class EncoderLayer(nnx.Module):
    """Self-attention and feed-forward, each added to what it was given."""

    def __init__(self, sizes: LayerSizes, *, xavier: bool, rngs: nnx.Rngs, dtype: DTypeLike):
        self.norm1 = layer_norm(sizes.width, rngs=rngs, dtype=dtype)
        self.attention = Attention(sizes, xavier=xavier, rngs=rngs, dtype=dtype)
        self.norm2 = layer_norm(sizes.width, rngs=rngs, dtype=dtype)
        self.feed_forward = FeedForward(sizes, xavier=xavier, rngs=rngs, dtype=dtype)
        self.dropout_rate, self.pre_norm = sizes.dropout, sizes.pre_norm

    def __call__(
        self,
        x: jax.Array,
        position: jax.Array,
        *,
        key: Key,
        keep: jax.Array | None = None,
        framing: TokenFrames | None = None,
    ) -> jax.Array:
        """Map tokens [B, N, D] with positions that broadcast to them, and perhaps frames."""
        keys = split_key(key, 4)
        before, after = _placed(self.pre_norm)
        y = before(self.norm1, x)
        q = y + position
        y = self.attention(q, q, y, key=keys[0], keep=keep, framing=(framing, framing))
        x = after(self.norm1, x + dropout(y, self.dropout_rate, keys[1]))
        y = self.feed_forward(before(self.norm2, x), key=keys[2])
        return after(self.norm2, x + dropout(y, self.dropout_rate, keys[3]))


Placed = Callable[[nnx.LayerNorm, jax.Array], jax.Array]


def _placed(pre_norm: bool) -> tuple[Placed, Placed]:
    """What to do with a norm before and after the layer it belongs to: one applies it."""

    def apply(norm: nnx.LayerNorm, x: jax.Array) -> jax.Array:
        return norm(x)

    def skip(norm: nnx.LayerNorm, x: jax.Array) -> jax.Array:
        del norm
        return x

    return (apply, skip) if pre_norm else (skip, apply)


class Encoder(nnx.Module):
    """A stack of encoder layers, with a layer norm at the end if they are pre-norm.

    ``xavier`` starts every matrix with Xavier's uniform, as the paper's main transformer does; its
    variational encoder keeps PyTorch's defaults.
    """

    def __init__(
        self, layers: int, sizes: LayerSizes, *, xavier: bool, rngs: nnx.Rngs, dtype: DTypeLike
    ):
        self.layers = nnx.List(
            EncoderLayer(sizes, xavier=xavier, rngs=rngs, dtype=dtype) for _ in range(layers)
        )
        self.norm = layer_norm(sizes.width, rngs=rngs, dtype=dtype) if sizes.pre_norm else None

    def __call__(
        self,
        x: jax.Array,
        position: jax.Array,
        *,
        key: Key,
        keep: jax.Array | None = None,
        framing: TokenFrames | None = None,
    ) -> jax.Array:
        """Map tokens [B, N, D]; ``keep`` [B, N] is False at tokens nobody may attend to."""
        for layer, layer_key in zip(self.layers, split_key(key, len(self.layers)), strict=True):
            x = layer(x, position, key=layer_key, keep=keep, framing=framing)
        return x if self.norm is None else self.norm(x)


class Decoder(nnx.Module):
    """One decoder layer and its final norm, started from zero tokens.

    The reference models build seven layers but read the output of the first, so one is enough.
    """

    def __init__(self, sizes: LayerSizes, *, rngs: nnx.Rngs, dtype: DTypeLike):
        def attention() -> Attention:
            return Attention(sizes, xavier=True, rngs=rngs, dtype=dtype)

        def norm() -> nnx.LayerNorm:
            return layer_norm(sizes.width, rngs=rngs, dtype=dtype)

        self.norm1 = norm()
        self.self_attention = attention()
        self.norm2 = norm()
        self.cross_attention = attention()
        self.norm3 = norm()
        self.feed_forward = FeedForward(sizes, xavier=True, rngs=rngs, dtype=dtype)
        self.norm = norm()
        self.dropout_rate, self.pre_norm = sizes.dropout, sizes.pre_norm

    def __call__(
        self,
        query: jax.Array,
        memory: jax.Array,
        position: jax.Array,
        *,
        key: Key,
        framing: TokenFrames | None = None,
    ) -> jax.Array:
        """Read ``memory`` [B, M, D], of these frames, at the learned ``query`` positions [T, D]."""
        keys = split_key(key, 6)
        rate = self.dropout_rate
        before, after = _placed(self.pre_norm)
        x = jnp.zeros((memory.shape[0], *query.shape), memory.dtype)
        y = before(self.norm1, x)
        q = y + query
        y = self.self_attention(q, q, y, key=keys[0])
        x = after(self.norm1, x + dropout(y, rate, keys[1]))
        y = before(self.norm2, x) + query
        y = self.cross_attention(y, memory + position, memory, key=keys[2], framing=(None, framing))
        x = after(self.norm2, x + dropout(y, rate, keys[3]))
        y = self.feed_forward(before(self.norm3, x), key=keys[4])
        return self.norm(after(self.norm3, x + dropout(y, rate, keys[5])))
