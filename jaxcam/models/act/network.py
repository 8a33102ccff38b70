"""ACT's network: from tokens of images and cameras to a chunk of actions."""

from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from jaxcam.models.act.config import ActConfig
from jaxcam.models.act.transformer import Decoder, Encoder, LayerSizes, sine_grid, sine_table
from jaxcam.models.fusion import Vision, camera_poses, token_frames
from jaxcam.models.layers import dropout, linear, split_key
from jaxcam.models.policy import Key, Obs, PolicySpec


def layer_sizes(config: ActConfig) -> LayerSizes:
    """Sizes of the transformer's layers."""
    return LayerSizes(
        config.width, config.heads, config.hidden, config.dropout, pre_norm=config.pre_norm
    )


class LatentEncoder(nnx.Module):
    """The variational encoder: from proprioception and the true actions to a Gaussian."""

    def __init__(self, config: ActConfig, spec: PolicySpec, *, rngs: nnx.Rngs):
        width, dtype = config.width, config.dtype
        self.proprio = linear(spec.proprio_dim, width, rngs=rngs, dtype=dtype)
        self.action = linear(spec.action_dim, width, rngs=rngs, dtype=dtype)
        layers, sizes = config.latent_layers, layer_sizes(config)
        self.encoder = Encoder(layers, sizes, xavier=False, rngs=rngs, dtype=dtype)
        self.out = linear(width, 2 * config.latent_dim, rngs=rngs, dtype=dtype)
        draw = jax.random.normal
        self.cls = nnx.Param(draw(rngs.params(), (1, width))) if config.learned_cls else None

    def __call__(
        self, proprio: jax.Array, action: jax.Array, is_pad: jax.Array, *, key: Key
    ) -> tuple[jax.Array, jax.Array]:
        """Mean and log variance, [B, latent] each; padded actions are not looked at."""
        proprio, action = self.proprio(proprio)[:, None], self.action(action)
        first = jnp.zeros_like(proprio)
        if self.cls is not None:
            first = jnp.broadcast_to(self.cls[...].astype(first.dtype), first.shape)
        x = jnp.concatenate([first, proprio, action], 1)
        keep = jnp.pad(~is_pad, ((0, 0), (2, 0)), constant_values=True)
        position = jnp.asarray(sine_table(*x.shape[1:]), x.dtype)
        x = self.encoder(x, position, key=key, keep=keep)
        mean, log_variance = jnp.split(self.out(x[:, 0]).astype(jnp.float32), 2, -1)
        return mean, log_variance


class TransformerHead(nnx.Module):
    """The paper's: tokens [image, pose, proprioception, latent] to a chunk of actions."""

    def __init__(self, config: ActConfig, spec: PolicySpec, vision: Vision, *, rngs: nnx.Rngs):
        width, dtype = config.width, config.dtype
        poses = max(config.pose_tokens, spec.views * (config.network == "token"))
        self.config = config
        self.poses = poses
        # A grid of the transformer's own width goes in as it is.
        projects = vision.width != width
        self.project = linear(vision.width, width, rngs=rngs, dtype=dtype) if projects else None
        self.pose = linear(16, width, rngs=rngs, dtype=dtype) if poses else None
        self.proprio = linear(spec.proprio_dim, width, rngs=rngs, dtype=dtype)
        latent = config.latent_dim
        self.latent = linear(latent, width, rngs=rngs, dtype=dtype) if latent else None

        def positions(count: int) -> nnx.Param:
            return nnx.Param(jax.random.normal(rngs.params(), (count, width)))

        learned = config.image_positions == "learned"
        self.grid, self.views = vision.grid, spec.views
        self.image_position = positions(spec.views * vision.tokens) if learned else None
        self.position = positions(poses + 1 + (latent > 0))
        self.query = positions(spec.chunk)
        sizes = layer_sizes(config)
        self.encoder = Encoder(config.layers, sizes, xavier=True, rngs=rngs, dtype=dtype)
        self.decoder = Decoder(sizes, rngs=rngs, dtype=dtype)
        self.action = linear(width, config.outputs(spec), rngs=rngs, dtype=dtype)
        # In the reference models, and trained by nothing: the loss does not look at it.
        self.is_pad = linear(width, 1, rngs=rngs, dtype=dtype) if config.pad_head else None

    def __call__(
        self, tokens: jax.Array, obs: Obs, proprio: jax.Array, latent: jax.Array, *, key: Key
    ) -> jax.Array:
        """Map tokens [B, V, N, F] and latent [B, L] to normalised outputs [B, T, O]."""
        dtype = self.config.dtype
        batch = tokens.shape[0]
        tokens = tokens.reshape(batch, -1, tokens.shape[-1])
        parts = [tokens if self.project is None else self.project(tokens)]
        if self.pose is not None:
            parts.append(self.pose(self._pose_vectors(obs, batch)))
        parts.append(self.proprio(proprio)[:, None])
        if self.latent is not None:
            parts.append(self.latent(latent)[:, None])
        x = jnp.concatenate([p.astype(dtype) for p in parts], 1)
        if self.image_position is None:
            table = np.tile(sine_grid(*self.grid, self.config.width), (self.views, 1))
        else:
            table = self.image_position[...]
        position = jnp.concatenate([table, self.position[...]]).astype(dtype)
        encoder_key, decoder_key = split_key(key, 2)
        framing = token_frames(self.config, obs, self.grid, self.config.width // self.config.heads)
        memory = self.encoder(x, position, key=encoder_key, framing=framing)
        query = self.query[...].astype(dtype)
        y = self.decoder(query, memory, position, key=decoder_key, framing=framing)
        return self.action(y)

    def _pose_vectors(self, obs: Obs, batch: int) -> jax.Array:
        """Flattened poses [B, pose tokens, 16]; a token without a camera gets zeros."""
        if self.config.network != "token":
            return jnp.zeros((batch, self.poses, 16))
        poses = camera_poses(self.config, obs).reshape(batch, -1, 16)
        return jnp.pad(poses, ((0, 0), (0, self.poses - poses.shape[1]), (0, 0)))


class MlpHead(nnx.Module):
    """All tokens side by side, through a perceptron, to a chunk of actions."""

    def __init__(self, config: ActConfig, spec: PolicySpec, vision: Vision, *, rngs: nnx.Rngs):
        dtype = config.dtype
        self.config = config
        self.chunk = spec.chunk
        token, pose_width = config.network == "token", config.encoder_width
        self.pose = linear(16, pose_width, rngs=rngs, dtype=dtype) if token else None
        d_in = spec.views * vision.tokens * vision.width + spec.proprio_dim + config.latent_dim
        d_in += spec.views * pose_width * token
        widths = (d_in, *(config.width,) * config.layers)
        self.layers = nnx.List(linear(a, b, rngs=rngs, dtype=dtype) for a, b in pairwise(widths))
        outputs = spec.chunk * config.outputs(spec)
        self.action = linear(config.width, outputs, rngs=rngs, dtype=dtype)

    def __call__(
        self, tokens: jax.Array, obs: Obs, proprio: jax.Array, latent: jax.Array, *, key: Key
    ) -> jax.Array:
        """Map tokens [B, V, N, F] and latent [B, L] to normalised outputs [B, T, O]."""
        batch = tokens.shape[0]
        parts = [tokens.reshape(batch, -1), proprio, latent]
        if self.pose is not None:
            poses = camera_poses(self.config, obs)
            parts.append(self.pose(poses.reshape(batch, -1, 16)).reshape(batch, -1))
        x = jnp.concatenate([p.astype(self.config.dtype) for p in parts], -1)
        for layer, layer_key in zip(self.layers, split_key(key, len(self.layers)), strict=True):
            x = dropout(jax.nn.relu(layer(x)), self.config.dropout, layer_key)
        return self.action(x).reshape(batch, self.chunk, -1)


class Prediction(NamedTuple):
    """What the network makes of a batch."""

    outputs: jax.Array
    """Normalised actions, with keyframes behind them if the settings ask for them, [B, T, O]."""
    kl: jax.Array
    """The latent's KL divergence, a scalar."""
    heat: jax.Array | None
    """Heat maps of the keypoints before the softmax [B*V, h, w, k], where there are any."""


class Act(nnx.Module):
    """The whole network, from raw observations to normalised actions."""

    def __init__(self, config: ActConfig, spec: PolicySpec, *, rngs: nnx.Rngs):
        self.config = config
        self.vision = Vision(config, spec, rngs=rngs)
        head = TransformerHead if config.head == "transformer" else MlpHead
        self.head = head(config, spec, self.vision, rngs=rngs)
        self.latent = LatentEncoder(config, spec, rngs=rngs) if config.latent_dim else None

    def __call__(
        self,
        obs: Obs,
        proprio: jax.Array,
        action: jax.Array | None = None,
        is_pad: jax.Array | None = None,
        *,
        key: Key = None,
    ) -> Prediction:
        """Predict a chunk.

        Args:
            obs: Images and cameras.
            proprio: Normalised proprioception [B, P].
            action: Normalised true actions [B, T, A]; without them the latent is zero.
            is_pad: Where those are padding, [B, T].
            key: For dropout and the latent's noise; none of either without it.
        """
        head_key, latent_key, noise_key = split_key(key, 3)
        latent = jnp.zeros((proprio.shape[0], self.config.latent_dim))
        kl = jnp.zeros(())
        if self.latent is not None and action is not None and is_pad is not None:
            mean, log_variance = self.latent(proprio, action, is_pad, key=latent_key)
            latent = mean
            if noise_key is not None:
                noise = jax.random.normal(noise_key, mean.shape)
                latent = mean + jnp.exp(log_variance / 2) * noise
            kl = -0.5 * (1 + log_variance - mean**2 - jnp.exp(log_variance)).sum(-1).mean()
        tokens, heat = self.vision.look(obs)
        out = self.head(tokens, obs, proprio, latent, key=head_key)
        return Prediction(out.astype(jnp.float32), kl, heat)
