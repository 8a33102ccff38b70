"""Diffusion Policy's network: images, cameras and noisy actions to the noise in them."""

from dataclasses import replace
from itertools import pairwise

import jax
import jax.numpy as jnp
from flax import nnx

from jaxcam.models.diffusion.config import DiffusionConfig
from jaxcam.models.diffusion.samplers import add_noise, cosine_alphas, make_table, sample
from jaxcam.models.diffusion.unet import UNet, UNetConfig
from jaxcam.models.fusion import Vision, camera_poses
from jaxcam.models.layers import linear
from jaxcam.models.losses import padded_mean
from jaxcam.models.policy import CAMERA_INPUTS, Obs, PolicySpec

POSE_FEATURES = 64
"""Numbers that a camera pose becomes, when the conditioning is token."""


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
        last = config.last_groups or config.groups
        unet = UNetConfig(config.channels, config.kernel, config.groups, last, config.step_width)
        self.unet = UNet(unet, spec.action_dim, d_global, local, rngs=rngs, dtype=dtype)

    def condition(self, obs: Obs, proprio: jax.Array) -> tuple[jax.Array, jax.Array]:
        """What the U-Net is conditioned on.

        Args:
            obs: Images and cameras [B, S, V, ...] of S steps.
            proprio: Normalised proprioception [B, S, P].

        Returns:
            Global condition [B, G], without a perceptron all of a step before the next step's, and
            local one [B, L].
        """
        batch, steps = proprio.shape[:2]
        flat = {k: obs[k].reshape(-1, *obs[k].shape[2:]) for k in CAMERA_INPUTS if k in obs}
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
        parts = []
        for vision, layer, views in zip(self.vision, self.features, apart, strict=True):
            tokens = vision(views)
            parts.append(layer(tokens.reshape(*tokens.shape[:2], -1)))
        features = jnp.concatenate(parts, 1)
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
