"""SmolVLA's network: a vision language model whose keys and values an action expert reads.

No image, word or state token ever attends to an action, neither in the paper's form nor in
LeRobot's. So the prefix is computed once, and what is left of it are its keys and values; that
holds in training as in sampling.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jax.typing import DTypeLike

from jaxcam.errors import ConfigError
from jaxcam.models.fusion import (
    Vision,
    camera_poses,
    canonical_images,
    grid_rays,
    table_view,
    token_frames,
)
from jaxcam.models.layers import linear
from jaxcam.models.policy import Obs, PolicySpec
from jaxcam.models.resnet import RayEncoder, space_to_depth
from jaxcam.models.smolvla.config import SmolVlaConfig
from jaxcam.models.smolvla.flow import time_embedding
from jaxcam.models.smolvla.siglip import Siglip
from jaxcam.models.smolvla.smollm import NORMAL, KeyValue, Layer, dense, rms_norm
from jaxcam.models.smolvla.stack import through
from jaxcam.models.token_frames import TokenFrames
from jaxcam.rays.rotations import Array

Contexts = tuple[KeyValue, ...]
"""One for each of the layers that follow each other in turn, with all their repetitions along the
first axis."""


class Prefix(NamedTuple):
    """What the expert may read of images, words and state."""

    contexts: Contexts
    is_there: jax.Array | None
    """[B, N] False at tokens that only fill a prompt up; None where all have one prompt."""
    summary: jax.Array
    """The last token, behind all layers, [B, width]."""


LayerBlock = tuple[Layer, ...]

PRETRAINED = ("vision", "connector", "embed", "text")
"""Parts that come from the vision language model; all others start at random."""


class RayFusion(nnx.Module):
    """The paper's late fusion: image tokens and ray tokens, normalised, concatenated, mixed."""

    def __init__(self, width: int, grid: int, cells: int, *, rngs: nnx.Rngs, dtype: DTypeLike):
        if grid % cells:
            raise ConfigError(
                f"A ray-map of {cells}x{cells} cells does not fit {grid}x{grid} image tokens."
            )
        self.repeats = grid // cells
        self.rays = RayEncoder(rngs=rngs, dtype=dtype)
        self.project = linear(512, width, rngs=rngs, dtype=dtype)
        self.mix = linear(2 * width, width, rngs=rngs, dtype=dtype)

    def __call__(self, tokens: jax.Array, rays: jax.Array) -> jax.Array:
        """Map image tokens [N, grid * grid, width] and rays [N, H, W, 6] to tokens."""
        x = self.project(self.rays(rays))
        x = x.repeat(self.repeats, 1).repeat(self.repeats, 2).reshape(tokens.shape)
        return self.mix(jnp.concatenate([_standardised(tokens), _standardised(x)], -1))


def _standardised(x: jax.Array) -> jax.Array:
    """Layer normalisation without weights."""
    y = x.astype(jnp.float32)
    y = y - y.mean(-1, keepdims=True)
    y = y * jax.lax.rsqrt(jnp.mean(y * y, -1, keepdims=True) + 1e-5)
    return y.astype(x.dtype)


class OwnTower(nnx.Module):
    """What the other policies see through, as tokens of the language model."""

    def __init__(self, config: SmolVlaConfig, spec: PolicySpec, *, rngs: nnx.Rngs):
        self.see = Vision(config, spec, rngs=rngs)
        self.connect = linear(self.see.width, config.width, rngs=rngs, dtype=config.dtype)
        count = spec.views * self.see.tokens
        self.position = nnx.Param(NORMAL(rngs.params(), (count, config.width)))

    def __call__(self, obs: Obs) -> jax.Array:
        """Tokens of all views in a row, [B, V * tokens, width]."""
        tokens = self.connect(self.see(obs))
        tokens = tokens.reshape(len(tokens), -1, tokens.shape[-1])
        return tokens + self.position[...].astype(tokens.dtype)


class SmolVla(nnx.Module):
    """The network, from raw observations and noisy actions to velocities."""

    def __init__(self, config: SmolVlaConfig, spec: PolicySpec, *, rngs: nnx.Rngs):
        dtype, width, expert = config.dtype, config.width, config.expert_width
        self.config = config
        self.turn = 2 if config.attention == "interleaved" else 1
        siglip = config.encoder == "siglip"
        self.tower = None if siglip else OwnTower(config, spec, rngs=rngs)
        self.vision = _siglip(config, rngs) if siglip else None
        self.connector = (
            dense(config.vision_width * config.shuffle**2, width, rngs=rngs, dtype=dtype)
            if siglip
            else None
        )
        self.embed = nnx.Embed(
            config.vocabulary, width, embedding_init=NORMAL, dtype=dtype, rngs=rngs
        )
        heads = config.heads, config.kv_heads, config.head_dim
        self.text = nnx.List(
            Layer(width, config.hidden, *heads, rngs=rngs, dtype=dtype)
            for _ in range(config.layers)
        )
        d_cross = config.kv_heads * config.head_dim
        self.expert = nnx.List(
            Layer(
                expert,
                config.expert_hidden,
                *heads,
                d_context=d_cross if config.crosses(i) else None,
                rngs=rngs,
                dtype=dtype,
            )
            for i in range(config.layers)
        )
        self.norm = rms_norm(expert, rngs=rngs, dtype=dtype)
        cells = -(-spec.height // 32)
        self.fusion = (
            RayFusion(config.vision_width, self.vision.grid, cells, rngs=rngs, dtype=dtype)
            if self.vision is not None and config.network == "late"
            else None
        )
        if config.network == "warp":
            table_view(config, spec.height, spec.width)  # refuses one that sees no table
        side = 0 if self.vision is None else self.vision.grid // config.shuffle
        self.grid = (side, side) if self.tower is None else self.tower.see.grid
        token = config.network == "token"
        self.pose = linear(16, width, rngs=rngs, dtype=dtype) if token else None
        self.state = linear(config.state_width, width, rngs=rngs, dtype=dtype)
        self.action_in = linear(config.actions(spec), expert, rngs=rngs, dtype=dtype)
        self.time_in = linear(2 * expert, expert, rngs=rngs, dtype=dtype)
        self.time_out = linear(expert, expert, rngs=rngs, dtype=dtype)
        self.action_out = linear(expert, config.actions(spec), rngs=rngs, dtype=jnp.float32)
        keyframes = 3 * spec.chunk if config.keyframe_weight else 0
        self.keyframe = (
            linear(width, keyframes, rngs=rngs, dtype=jnp.float32) if keyframes else None
        )

    def prefix(self, obs: Obs, state: jax.Array) -> Prefix:
        """Read images, cameras, the prompt and the normalised state [B, state_width]."""
        batch = state.shape[0]
        images = self._images(obs).reshape(batch, -1, self.config.width)
        words, is_word = self._words(obs, batch)
        if self.config.scale_embeddings:
            images, words = images * self.config.width**0.5, words * self.config.width**0.5
        parts = [images, words]
        if self.pose is not None:
            poses = camera_poses(self.config, obs)
            parts.append(self.pose(poses.reshape(*poses.shape[:2], 16)))
        parts.append(self.state(state)[:, None])
        x = jnp.concatenate([p.astype(self.config.dtype) for p in parts], 1)
        # Rotary positions of its own tell tokens apart.
        framing = token_frames(self.config, obs, self.grid, self.config.head_dim, cells=False)
        if is_word is None:
            return self._read(x, None, framing)
        before, behind = images.shape[1], x.shape[1] - images.shape[1] - words.shape[1]
        is_there = jnp.pad(is_word, ((0, 0), (before, behind)), constant_values=True)
        return self._read(x, is_there, framing)

    def velocity(self, prefix: Prefix, x: jax.Array, time: jax.Array) -> jax.Array:
        """Velocities at noisy actions [B, T, W] and times [B], float32 [B, T, W]."""
        x = self.action_in(x)
        time = time_embedding(time, x.shape[-1]).astype(x.dtype)
        x = jnp.concatenate([x, jnp.broadcast_to(time[:, None], x.shape)], -1)
        x = self.time_out(jax.nn.silu(self.time_in(x)))
        crosses = [self.config.crosses(i) for i in range(self.turn)]

        def step(block: LayerBlock, x: jax.Array, contexts: Contexts) -> tuple[jax.Array, None]:
            for layer, context, cross in zip(block, contexts, crosses, strict=True):
                x = (_cross_layer if cross else _joint_layer)(layer, x, context, prefix.is_there)
            return x, None

        x, _ = through(self._turns(self.expert), step, x, prefix.contexts, remat=self.config.remat)
        return self.action_out(self.norm(x).astype(jnp.float32))

    def _words(self, obs: Obs, batch: int) -> tuple[jax.Array, jax.Array | None]:
        """Embedded prompts [B, N, width], and which tokens are words where they differ."""
        prompts = (self.config.tokens, *self.config.other_tokens)
        if len(prompts) == 1:
            words = self.embed(jnp.asarray(prompts[0]))
            return jnp.broadcast_to(words, (batch, *words.shape)), None
        longest = max(map(len, prompts))
        table = np.array([[*tokens, *[0] * (longest - len(tokens))] for tokens in prompts])
        lengths = jnp.asarray([len(tokens) for tokens in prompts])
        asked = obs["instruction"] if "instruction" in obs else jnp.zeros(batch, int)
        is_word = jnp.arange(longest) < lengths[asked][:, None]
        return self.embed(jnp.asarray(table)[asked]), is_word

    def _read(
        self, x: jax.Array, is_there: jax.Array | None, framing: TokenFrames | None
    ) -> Prefix:
        positions: Array = np.arange(x.shape[1])
        # The state, the last token, is a block of its own; before it everyone sees everyone.
        mask: Array = np.tri(len(positions), dtype=bool)
        if self.config.mask == "blocks":
            mask[:-1, :-1] = True
        if is_there is not None:  # tokens that fill up are not counted and not seen
            positions = jnp.cumsum(is_there, 1) - 1
            mask = mask & is_there[:, None]
        crosses = [self.config.crosses(i) for i in range(self.turn)]

        def step(
            blocks: tuple[LayerBlock, LayerBlock], x: jax.Array, _: None
        ) -> tuple[jax.Array, Contexts]:
            contexts = []
            for layer, reader, cross in zip(*blocks, crosses, strict=True):
                y = layer.norm1(x)
                plain = layer.keys_values(y, positions)
                context = plain.framed(framing)
                x = layer.attend(x, layer.queries(y, positions), context, mask, framing)
                contexts.append(reader.read(plain).framed(framing) if cross else context)
            return x, tuple(contexts)

        both = list(zip(self._turns(self.text), self._turns(self.expert), strict=True))
        x, contexts = through(both, step, x, remat=self.config.remat)
        return Prefix(contexts, is_there, x[:, -1])

    def _turns(self, layers: Sequence[Layer]) -> list[LayerBlock]:
        """Layers in groups that look alike: single ones, or pairs if every other one differs."""
        return [tuple(layers[i : i + self.turn]) for i in range(0, len(layers), self.turn)]

    def _images(self, obs: Obs) -> jax.Array:
        """Tokens of every picture, [B * V, tokens, width] or [B, V * tokens, width]."""
        config = self.config
        if self.tower is not None:
            return self.tower(obs)
        assert self.vision is not None, "one of the two sees"
        assert self.connector is not None
        pictures = canonical_images(config, obs) if config.network == "warp" else obs["image"]
        pictures = pictures.reshape(-1, *pictures.shape[2:])
        x = pictures.astype(jnp.float32) / 127.5 - 1
        shape = (x.shape[0], config.image_size, config.image_size, 3)
        # Bilinear as PyTorch's interpolation is: half-pixel centres, nothing filtered.
        x = jax.image.resize(x, shape, "bilinear", antialias=False)
        x = self.vision(x.astype(config.dtype), remat=config.remat)
        if self.fusion is not None:
            authors = config.ray_convention == "authors"
            rays = grid_rays(config, obs, *pictures.shape[1:3], authors=authors)
            # The authors scale all nine channels alike.
            x = self.fusion(x, (2 * rays - 1).astype(config.dtype))
        grid = self.vision.grid
        x = space_to_depth(x.reshape(-1, grid, grid, x.shape[-1]), config.shuffle)
        return self.connector(x.reshape(x.shape[0], -1, x.shape[-1]))


def _siglip(config: SmolVlaConfig, rngs: nnx.Rngs) -> Siglip:
    sizes = config.image_size, config.patch, config.vision_width, config.vision_layers
    return Siglip(*sizes, config.vision_heads, config.vision_hidden, rngs=rngs, dtype=config.dtype)


def _joint_layer(
    layer: Layer, x: jax.Array, context: KeyValue, is_there: jax.Array | None
) -> jax.Array:
    """Actions attend to the prefix and to the actions before them."""
    past, count = context.key.shape[1], x.shape[1]
    positions = past + np.arange(count)
    if is_there is not None:
        positions = is_there.sum(1, keepdims=True) + np.arange(count)
    y = layer.norm1(x)
    own = layer.keys_values(y, positions)
    whole = KeyValue(*(jnp.concatenate(pair, 1) for pair in zip(context, own, strict=True)))
    mask = np.concatenate([np.ones((count, past), bool), np.tri(count, dtype=bool)], 1)
    if is_there is not None:
        mask = mask & jnp.pad(is_there, ((0, 0), (0, count)), constant_values=True)[:, None]
    return layer.attend(x, layer.queries(y, positions), whole, mask)


def _cross_layer(
    layer: Layer, x: jax.Array, context: KeyValue, is_there: jax.Array | None
) -> jax.Array:
    """Actions attend to the prefix only; their positions start at 0."""
    query = layer.queries(layer.norm1(x), np.arange(x.shape[1]))
    mask = None if is_there is None else is_there[:, None].repeat(x.shape[1], 1)
    return layer.attend(x, query, context, mask)
