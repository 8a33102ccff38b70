"""Diffusion Policy: chunks of actions denoised from noise by a 1-D U-Net.

Public sources: the paper's authors' code for the preset `paper`, LeRobot 0.4.4 for `lerobot`, the
Diffusion Policy repository (hybrid image variant) for `original`.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from jaxcam.errors import ConfigError
from jaxcam.models.crops import window
from jaxcam.models.fusion import (
    Vision,
    VisionConfig,
    camera_poses,
    check_known,
    with_conditioning,
)
from jaxcam.models.layers import linear
from jaxcam.models.losses import PADDINGS, padded_mean, repeat_ends
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
from jaxcam.models.samplers import SAMPLERS, add_noise, cosine_alphas, make_table, sample
from jaxcam.models.unet import UNet, UNetConfig

POSE_FEATURES = 64
"""Numbers that a camera pose becomes, when the conditioning is token."""


@dataclass(frozen=True)
class DiffusionConfig(VisionConfig):
    """Settings of Diffusion Policy; the defaults are the paper's, as the authors trained it."""

    conditioning: str = "early"
    twin_of: str = "early"
    ray_convention: Literal["jaxcam", "authors"] = "authors"
    norm: str = "group"
    image_scaling: str = "unit"
    pool: str = "softmax"
    heat_gain: float = 1.0
    chunk: int = 32
    """Actions predicted at a time, from the oldest observation on."""
    execute: int = 0
    """Actions, from the newest observation on, that are executed before the policy is asked again;
    0 is all of them."""
    obs_steps: int = 1
    """Observations the policy sees: the newest and those of the steps before it."""
    crop: int = 0
    """Side in pixels of the square the policy looks at: random in training, else central; 0 is the
    whole image."""
    encoder_per_view: bool = False
    """Whether every view has an image encoder of its own."""
    features: int = 64
    """Numbers that a view's tokens become."""
    features_relu: bool = True
    """Whether those are rectified."""
    hidden: tuple[int, ...] = ()
    """Widths of a perceptron that all that conditions the chunk as a whole goes through first; the
    public implementations have none."""
    local_proprio: bool = True
    """Whether proprioception conditions every step of the chunk, instead of the chunk as a
    whole."""
    drop_proprio: bool = True
    """Whether proprioception is replaced by zeros (before normalisation), as in the paper."""
    keyframe_weight: float = 0.0
    """Weight of the loss on keyframes, which the condition then has to tell; 0 asks for none. A
    keyframe is where the grip will be when its command next changes."""
    channels: tuple[int, ...] = (512, 1024, 2048)
    """Width of every stage of the U-Net."""
    kernel: int = 5
    """Steps that a convolution of the U-Net sees."""
    groups: int = 8
    """Groups of the U-Net's norms."""
    step_width: int = 128
    """Width of the noising step's embedding."""
    noising_steps: int = 100
    """Steps of the noising process."""
    sampler: str = "ddpm"
    """How actions are drawn: ddpm, or ddim, which adds no noise and may take fewer steps."""
    sample_steps: int = 100
    """Denoising steps when acting."""
    temperature: float = 1.0
    """Scale of all noise that actions are drawn with; below 1 they vary less, at 0 not at all."""
    padding: str = "sample"
    """How steps past a demonstration's end count in the loss, see `padded_mean`. With sample they
    are zeros before normalisation, as in the paper, otherwise copies of the last action."""

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        super().__post_init__()
        check_known(self, sampler=SAMPLERS, padding=PADDINGS)
        multiple = 2 ** (len(self.channels) - 1)
        if self.chunk % multiple:
            raise ConfigError(
                f"chunk {self.chunk} is not a multiple of {multiple}, as {len(self.channels)} "
                "stages of the U-Net need."
            )
        if any(width % self.groups for width in self.channels):
            raise ConfigError(
                f"channels {self.channels} are not multiples of groups {self.groups}."
            )
        if not 1 <= self.sample_steps <= self.noising_steps:
            raise ConfigError(
                f"sample_steps must be 1 to noising_steps ({self.noising_steps}), "
                f"got {self.sample_steps}."
            )
        for name in ("execute", "keyframe_weight", "crop", "temperature"):
            if getattr(self, name) < 0:
                raise ConfigError(f"{name} must not be negative, got {getattr(self, name)}.")
        if not 1 <= self.obs_steps < self.chunk:
            raise ConfigError(f"obs_steps must be 1 to {self.chunk - 1}, got {self.obs_steps}.")


_PUBLIC = DiffusionConfig(
    conditioning="none",
    twin_of="none",
    ray_convention="jaxcam",
    chunk=16,
    execute=8,
    obs_steps=2,
    local_proprio=False,
    drop_proprio=False,
    padding="counted",
)

DIFFUSION_PRESETS: dict[str, DiffusionConfig] = {
    "paper": DiffusionConfig(),
    "lerobot": replace(_PUBLIC, image_scaling="imagenet"),
    "original": replace(
        _PUBLIC,
        image_scaling="symmetric",
        crop=76,
        encoder_per_view=True,
        features_relu=False,
    ),
    "laptop": DiffusionConfig(
        conditioning="keypoints",
        twin_of="keypoints",
        ray_convention="jaxcam",
        encoder="small",
        encoder_width=32,
        encoder_depth=2,
        image_scaling="symmetric",
        pool="keypoints",
        heat_gain=25.0,
        chunk=16,
        execute=8,
        features=256,
        hidden=(256, 256),
        local_proprio=False,
        drop_proprio=False,
        keyframe_weight=0.9,
        channels=(32, 64, 128),
        step_width=64,
        sampler="ddim",
        sample_steps=10,
        temperature=0.5,
        padding="valid",
    ),
}


class Diffusion(nnx.Module):
    """The whole network, from raw observations to the noise in normalised actions."""

    def __init__(self, config: DiffusionConfig, spec: PolicySpec, *, rngs: nnx.Rngs):
        self.config = config
        dtype, width = config.dtype, config.features
        side = {"height": config.crop, "width": config.crop} if config.crop else {}
        encoders = spec.views if config.encoder_per_view else 1
        sizes = replace(spec, **side)
        self.vision = nnx.List(Vision(config, sizes, rngs=rngs) for _ in range(encoders))
        self.features = nnx.List(
            linear(v.tokens * v.width, width, rngs=rngs, dtype=dtype) for v in self.vision
        )
        token = config.network == "token"
        self.pose = linear(16, POSE_FEATURES, rngs=rngs, dtype=dtype) if token else None
        local = spec.proprio_dim * config.local_proprio
        d_global = spec.views * (width + POSE_FEATURES * token) + spec.proprio_dim - local
        widths = (d_global * config.obs_steps, *config.hidden)
        self.hidden = nnx.List(linear(a, b, rngs=rngs, dtype=dtype) for a, b in pairwise(widths))
        d_global = widths[-1]
        self.keyframe = (
            linear(d_global, 3 * spec.chunk, rngs=rngs, dtype=jnp.float32)
            if config.keyframe_weight
            else None
        )
        unet = UNetConfig(config.channels, config.kernel, config.groups, config.step_width)
        self.unet = UNet(unet, spec.action_dim, d_global, local, rngs=rngs, dtype=dtype)

    def condition(self, obs: Obs, proprio: jax.Array) -> tuple[jax.Array, jax.Array]:
        """What the U-Net is told.

        Args:
            obs: Images and cameras [B, S, V, ...] of S steps.
            proprio: Normalised proprioception [B, S, P].

        Returns:
            Global condition [B, G], without a perceptron all of a step before the next step's, and
            local one [B, L].
        """
        batch, steps = proprio.shape[:2]
        names = ("image", "K", "base_from_camera")
        flat = {k: obs[k].reshape(-1, *obs[k].shape[2:]) for k in names}
        parts = [self._views(flat)]
        if not self.config.local_proprio:
            parts.insert(0, proprio.reshape(batch * steps, -1))
        if self.pose is not None:
            poses = camera_poses(self.config, flat)
            parts.append(self.pose(poses.reshape(*poses.shape[:2], 16)).reshape(len(poses), -1))
        together = jnp.concatenate([p.astype(jnp.float32) for p in parts], -1)
        local = proprio[:, -1] if self.config.local_proprio else proprio[:, -1, :0]
        together = together.reshape(batch, -1)
        for layer in self.hidden:
            together = jax.nn.relu(layer(together))
        return together, local

    def _views(self, obs: Obs) -> jax.Array:
        """Features of all views side by side, [B, V * features]."""
        apart = [obs]
        if len(self.vision) > 1:
            apart = [{k: v[:, i : i + 1] for k, v in obs.items()} for i in range(len(self.vision))]
        found = []
        for vision, layer, some in zip(self.vision, self.features, apart, strict=True):
            tokens = vision(some)
            found.append(layer(tokens.reshape(*tokens.shape[:2], -1)))
        features = jnp.concatenate(found, 1)
        features = jax.nn.relu(features) if self.config.features_relu else features
        return features.reshape(len(features), -1)

    def noise_loss(
        self,
        target: jax.Array,
        is_pad: jax.Array,
        condition: tuple[jax.Array, jax.Array],
        noise: jax.Array,
        t: jax.Array,
    ) -> jax.Array:
        """Mean squared error on noise [B, T, A] added at steps t [B] to normalised actions."""
        noisy = add_noise(cosine_alphas(self.config.noising_steps), target, noise, t)
        error = jnp.square(self.unet(noisy, t, *condition) - noise)
        return padded_mean(error, is_pad, self.config.padding)

    def denoise(
        self, condition: tuple[jax.Array, jax.Array], x: jax.Array, fresh: jax.Array | None
    ) -> jax.Array:
        """Normalised actions from noise x [B, T, A], and fresh noise of every step if DDPM."""
        config = self.config
        table = make_table(config.sampler, cosine_alphas(config.noising_steps), config.sample_steps)

        def predict(x: jax.Array, t: jax.Array) -> jax.Array:
            return self.unet(x, jnp.full(len(x), t), *condition)

        return sample(table, predict, x, fresh)


def middle_and_half(stats: Stats, name: str, least: float) -> tuple[np.ndarray, np.ndarray]:
    """Middle and half of a quantity's range; halves below `least` are that."""
    low, high = (np.asarray(stats[f"{name}_{end}"], np.float32) for end in ("min", "max"))
    return (low + high) / 2, np.maximum((high - low) / 2, np.float32(least))


def proprio_middle_and_half(stats: Stats) -> tuple[np.ndarray, np.ndarray]:
    """Those of proprioception; what never varied is not blown up by a first value that does."""
    middle, half = middle_and_half(stats, "proprio", 1e-6)
    return middle, np.where(half < 1e-3, 1, half).astype(np.float32)


def make_diffusion(config: DiffusionConfig, spec: PolicySpec, stats: Stats) -> Policy:
    """Make Diffusion Policy's three functions; statistics become constants of them."""
    check_sizes(config.chunk, spec, stats)
    if config.crop > min(spec.height, spec.width):
        raise ConfigError(
            f"A crop of {config.crop} pixels does not fit in {spec.height}x{spec.width}."
        )
    middle, half = middle_and_half(stats, "action", 1e-6)
    proprio_middle, proprio_half = proprio_middle_and_half(stats)
    init, network = pure(lambda rngs: Diffusion(config, spec, rngs=rngs))
    chunk = (config.chunk, spec.action_dim)

    def condition(net: Diffusion, obs: Obs, key: Key) -> tuple[jax.Array, jax.Array]:
        names = ("image", "K", "base_from_camera", "proprio")
        seen = {k: jnp.asarray(obs[k]) for k in names}
        if config.obs_steps == 1:
            seen = {k: v[:, None] for k, v in seen.items()}
        if config.crop:
            seen |= window(seen, config.crop, key)
        proprio = jnp.zeros_like(seen["proprio"]) if config.drop_proprio else seen["proprio"]
        return net.condition(seen, (proprio - proprio_middle) / proprio_half)

    def loss(params: Params, batch: Batch, key: Key) -> tuple[jax.Array, dict[str, jax.Array]]:
        # Without a key the draws are always the same, so that such losses can be compared.
        keys = jax.random.split(jax.random.key(0) if key is None else key, 3)
        net, is_pad = network(params), batch["is_pad"]
        told = condition(net, batch, None if key is None else keys[0])
        target = (batch["action"] - middle) / half
        if config.padding != "sample":
            target = repeat_ends(target, is_pad)
        t = jax.random.randint(keys[1], target.shape[:1], 0, config.noising_steps)
        noise = jax.random.normal(keys[2], target.shape)
        total = mse = net.noise_loss(target, is_pad, told, noise, t)
        metrics = {"mse": mse}
        if net.keyframe is not None:
            keyframe = (batch["keyframe"] - stats["keyframe_mean"]) / stats["keyframe_std"]
            error = jnp.abs(net.keyframe(told[0]).reshape(keyframe.shape) - keyframe)
            metrics["keyframe"] = padded_mean(error, is_pad, "valid")
            total += config.keyframe_weight * metrics["keyframe"]
        return total, {"loss": total, **metrics}

    def act(params: Params, obs: Obs, key: Key) -> jax.Array:
        net, batch = network(params), len(obs["proprio"])
        x, fresh = jnp.zeros((batch, *chunk)), None
        if key is not None:
            first, later = jax.random.split(key)
            x = config.temperature * jax.random.normal(first, x.shape)
            if config.sampler == "ddpm":
                fresh = jax.random.normal(later, (config.sample_steps, *x.shape))
                fresh = config.temperature * fresh
        actions = net.denoise(condition(net, obs, None), x, fresh)
        return (actions * half + middle)[:, config.obs_steps - 1 :]

    left = config.chunk - config.obs_steps + 1
    return Policy(init, loss, act, config, spec, min(config.execute or left, left))


FAMILY = Family(DiffusionConfig, DIFFUSION_PRESETS, make_diffusion, with_conditioning)
