"""SigLIP's vision transformer as SmolVLM2 has it: no class token, learned positions, pre-norm."""

import jax
from flax import nnx
from jax.typing import DTypeLike

from jaxcam.models.smolvla.smollm import NORMAL, dense
from jaxcam.models.smolvla.stack import through


class SiglipLayer(nnx.Module):
    """Self-attention and a tanh-GELU perceptron, each on a normalised copy and added back."""

    def __init__(self, width: int, heads: int, hidden: int, *, rngs: nnx.Rngs, dtype: DTypeLike):
        def layer(d_in: int, d_out: int) -> nnx.Linear:
            return dense(d_in, d_out, bias=True, rngs=rngs, dtype=dtype)

        self.heads = heads
        self.norm1 = siglip_norm(width, rngs=rngs, dtype=dtype)
        self.query, self.key, self.value = (layer(width, width) for _ in range(3))
        self.out = layer(width, width)
        self.norm2 = siglip_norm(width, rngs=rngs, dtype=dtype)
        self.up, self.down = layer(width, hidden), layer(hidden, width)

    def __call__(self, x: jax.Array) -> jax.Array:
        """Map tokens [B, N, width]."""
        y = self.norm1(x)
        q, k, v = (
            layer(y).reshape(*y.shape[:2], self.heads, -1)
            for layer in (self.query, self.key, self.value)
        )
        x = x + self.out(jax.nn.dot_product_attention(q, k, v).reshape(y.shape))
        return x + self.down(jax.nn.gelu(self.up(self.norm2(x)), approximate=True))


def siglip_norm(width: int, *, rngs: nnx.Rngs, dtype: DTypeLike) -> nnx.LayerNorm:
    """SigLIP's layer normalisation."""
    return nnx.LayerNorm(width, epsilon=1e-6, dtype=dtype, use_fast_variance=False, rngs=rngs)


class Siglip(nnx.Module):
    """The tower.

    Args:
        size: Image side in pixels.
        patch: Patch side in pixels.
        width: Numbers a token.
        layers: Number of layers.
        heads: Attention heads.
        hidden: Hidden width of the perceptrons.
    """

    def __init__(
        self,
        size: int,
        patch: int,
        width: int,
        layers: int,
        heads: int,
        hidden: int,
        *,
        rngs: nnx.Rngs,
        dtype: DTypeLike,
    ):
        self.grid = size // patch
        self.patch = nnx.Conv(
            3,
            width,
            (patch, patch),
            strides=patch,
            padding="VALID",
            kernel_init=NORMAL,
            dtype=dtype,
            rngs=rngs,
        )
        self.position = nnx.Param(NORMAL(rngs.params(), (self.grid**2, width)))
        self.layers = nnx.List(
            SiglipLayer(width, heads, hidden, rngs=rngs, dtype=dtype) for _ in range(layers)
        )
        self.norm = siglip_norm(width, rngs=rngs, dtype=dtype)

    def __call__(self, images: jax.Array, *, remat: bool) -> jax.Array:
        """Map images [N, S, S, 3] in -1..1 to tokens [N, grid * grid, width], row by row."""
        x = self.patch(images)
        x = x.reshape(x.shape[0], -1, x.shape[-1])
        x = x + self.position[...].astype(x.dtype)
        x, _ = through(self.layers, lambda layer, x, _: (layer(x), None), x, remat=remat)
        return self.norm(x)
