"""ACT: action chunks from tokens of images and cameras, optionally with a variational latent."""

from dataclasses import dataclass, replace
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from jaxcam.errors import ConfigError
from jaxcam.models.fusion import (
    Vision,
    VisionConfig,
    camera_poses,
    check_known,
    with_conditioning,
)
from jaxcam.models.layers import dropout, linear, split_key
from jaxcam.models.losses import PADDINGS, padded_mean
from jaxcam.models.policy import (
    Batch,
    Family,
    Key,
    Obs,
    Params,
    Policy,
    PolicySpec,
    Stats,
    check_sizes,
    pure,
)
from jaxcam.models.transformer import Decoder, Encoder, sine_grid, sine_table


@dataclass(frozen=True)
class ActConfig(VisionConfig):
    """Settings of ACT; the defaults are the paper's, as the authors trained it."""

    chunk: int = 30
    """Actions predicted at a time."""
    execute: int = 0
    """Actions of a chunk that are executed before the policy is asked again; 0 is all of them."""
    keyframe_weight: float = 0.0
    """Weight of the loss on keyframes, which the policy then predicts beside every action; 0
    predicts none. A keyframe is where the grip will be when its command next changes."""
    head: str = "transformer"
    """From tokens to actions: the paper's transformer, or an mlp over all tokens at once."""
    width: int = 512
    """Width of the transformer, or of the perceptron's hidden layers."""
    heads: int = 8
    """Attention heads."""
    hidden: int = 2048
    """Hidden width of the transformer's feed-forward layers."""
    layers: int = 4
    """Encoder layers of the transformer, or hidden layers of the perceptron."""
    pre_norm: bool = True
    """Whether the transformer's norms come before its layers, as in the paper, or after them."""
    image_positions: str = "learned"
    """Positions of image tokens: learned for every view, or the same sine table for all."""
    learned_cls: bool = False
    """Whether the variational encoder's first token is learned or zero."""
    pad_head: bool = True
    """Whether there is a head for padding, which some public weights have and nobody trains."""
    pose_tokens: int = 2
    """Least number of pose tokens; they are fed with zeros unless the conditioning is token."""
    latent_dim: int = 32
    """Size of the variational latent; 0 builds no variational encoder."""
    latent_layers: int = 4
    """Layers of the variational encoder."""
    kl_weight: float = 1.0
    """Weight of the latent's KL divergence in the loss."""
    dropout: float = 0.1
    """Dropout rate in training."""
    drop_proprio: bool = True
    """Whether proprioception is replaced by zeros (before normalisation), as in the paper."""
    action_std_floor: float = 1e-4
    """Least deviation that actions are divided by."""
    padding: str = "zeroed"
    """How steps past a demonstration's end count in the loss, see `padded_mean`."""

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        super().__post_init__()
        known = {"head": ("transformer", "mlp"), "image_positions": ("learned", "sine")}
        check_known(self, padding=PADDINGS, **known)
        if self.width % self.heads:
            raise ConfigError(f"width {self.width} is not a multiple of heads {self.heads}.")
        if self.execute < 0 or self.keyframe_weight < 0:
            raise ConfigError("execute and keyframe_weight must not be negative.")

    def outputs(self, spec: PolicySpec) -> int:
        """Numbers predicted a step: an action and, if asked for, its keyframe's position."""
        return spec.action_dim + 3 * (self.keyframe_weight > 0)


_PUBLIC = ActConfig(
    conditioning="none",
    twin_of="none",
    norm="frozen",
    chunk=100,
    hidden=3200,
    pre_norm=False,
    image_positions="sine",
    learned_cls=True,
    pose_tokens=0,
    kl_weight=10.0,
    drop_proprio=False,
)

ACT_PRESETS: dict[str, ActConfig] = {
    "paper": ActConfig(ray_convention="authors"),
    "lerobot": replace(_PUBLIC, pad_head=False),
    "original": replace(_PUBLIC, action_std_floor=1e-2),
    "laptop": ActConfig(
        conditioning="keypoints",
        twin_of="keypoints",
        encoder="small",
        encoder_width=32,
        encoder_depth=2,
        image_scaling="symmetric",
        pool="keypoints",
        chunk=16,
        execute=8,
        keyframe_weight=0.9,
        drop_proprio=False,
        head="mlp",
        width=256,
        layers=2,
        hidden=512,
        pose_tokens=0,
        latent_dim=0,
        dropout=0.0,
    ),
}


class LatentEncoder(nnx.Module):
    """The variational encoder: from proprioception and the true actions to a Gaussian."""

    def __init__(self, config: ActConfig, spec: PolicySpec, *, rngs: nnx.Rngs):
        width, dtype = config.width, config.dtype
        self.proprio = linear(spec.proprio_dim, width, rngs=rngs, dtype=dtype)
        self.action = linear(spec.action_dim, width, rngs=rngs, dtype=dtype)
        self.encoder = Encoder(
            config.latent_layers,
            width,
            config.heads,
            config.hidden,
            config.dropout,
            pre_norm=config.pre_norm,
            xavier=False,
            rngs=rngs,
            dtype=dtype,
        )
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
        self.encoder = Encoder(
            config.layers,
            width,
            config.heads,
            config.hidden,
            config.dropout,
            pre_norm=config.pre_norm,
            xavier=True,
            rngs=rngs,
            dtype=dtype,
        )
        self.decoder = Decoder(
            width,
            config.heads,
            config.hidden,
            config.dropout,
            pre_norm=config.pre_norm,
            rngs=rngs,
            dtype=dtype,
        )
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
        memory = self.encoder(x, position, key=encoder_key)
        y = self.decoder(self.query[...].astype(dtype), memory, position, key=decoder_key)
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
    ) -> tuple[jax.Array, jax.Array]:
        """Predict a chunk.

        Args:
            obs: Images and cameras.
            proprio: Normalised proprioception [B, P].
            action: Normalised true actions [B, T, A]; without them the latent is zero.
            is_pad: Where those are padding, [B, T].
            key: For dropout and the latent's noise; none of either without it.

        Returns:
            Normalised actions, with keyframes behind them if the settings ask for them, [B, T, O],
            and the latent's KL divergence, a scalar.
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
        out = self.head(self.vision(obs), obs, proprio, latent, key=head_key)
        return out.astype(jnp.float32), kl


def action_scale(std: np.ndarray, floor: float) -> np.ndarray:
    """Deviations to divide actions by: at least the floor.

    A floor, and not 1, for a dimension that never varies: what the network gets wrong about it
    then shrinks to nothing in raw units instead of drifting over an episode.
    """
    return np.maximum(np.asarray(std, np.float32), np.float32(floor))


def proprio_scale(std: np.ndarray) -> np.ndarray:
    """Deviations to divide proprioception by: 1 where a dimension never varies.

    Here a floor would do harm, since it blows up the first value that does differ.
    """
    std = np.asarray(std, np.float32)
    return np.where(std < 1e-3, 1.0, std).astype(np.float32)


def make_act(config: ActConfig, spec: PolicySpec, stats: Stats) -> Policy:
    """Make ACT's three functions; statistics become constants of them."""
    check_sizes(config.chunk, spec, stats)
    action_mean = np.asarray(stats["action_mean"], np.float32)
    action_std = action_scale(stats["action_std"], config.action_std_floor)
    proprio_mean = np.asarray(stats["proprio_mean"], np.float32)
    proprio_std = proprio_scale(stats["proprio_std"])
    init, network = pure(lambda rngs: Act(config, spec, rngs=rngs))

    def proprio(obs: Obs) -> jax.Array:
        raw = jnp.zeros_like(obs["proprio"]) if config.drop_proprio else obs["proprio"]
        return (raw - proprio_mean) / proprio_std

    def l1_loss(predicted: jax.Array, target: jax.Array, is_pad: jax.Array) -> jax.Array:
        return padded_mean(jnp.abs(predicted - target), is_pad, config.padding)

    def loss(params: Params, batch: Batch, key: Key) -> tuple[jax.Array, dict[str, jax.Array]]:
        target = (batch["action"] - action_mean) / action_std
        is_pad = batch["is_pad"]
        predicted, kl = network(params)(batch, proprio(batch), target, is_pad, key=key)
        l1 = l1_loss(predicted[..., : spec.action_dim], target, is_pad)
        total = l1 + config.kl_weight * kl
        metrics = {"l1": l1, "kl": kl}
        if config.keyframe_weight:
            keyframe = (batch["keyframe"] - stats["keyframe_mean"]) / stats["keyframe_std"]
            metrics["keyframe"] = l1_loss(predicted[..., spec.action_dim :], keyframe, is_pad)
            total += config.keyframe_weight * metrics["keyframe"]
        return total, {"loss": total, **metrics}

    def act(params: Params, obs: Obs, key: Key) -> jax.Array:
        del key  # ACT acts with its latent at zero: nothing is drawn.
        predicted = network(params)(obs, proprio(obs))[0][..., : spec.action_dim]
        return predicted * action_std + action_mean

    return Policy(init, loss, act, config, spec, min(config.execute or spec.chunk, spec.chunk))


FAMILY = Family(ActConfig, ACT_PRESETS, make_act, with_conditioning)
