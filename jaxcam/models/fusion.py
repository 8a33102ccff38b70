"""How a policy is told where its cameras are: every way of conditioning, in one place.

A `Vision` module turns the images and cameras of an observation into tokens, and policies build on
those. The ways:

- ``token``: the flattened camera pose, linearly projected, is one more token.
- ``early``: the ray-map joins the image as six more input channels.
- ``late``: the ray-map has an encoder of its own; the two feature maps are concatenated and mixed.
- ``keypoints``: heat maps over the image pool the ray-map, so that a keypoint is a line in space.
- ``none``: the camera pose is hidden. The network is that of ``twin_of``, fed with the pose of one
  camera that is always the same, so that the two differ in nothing but what they are told. With
  ``twin_of="none"`` there is no ray path at all.
"""

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jax.typing import DTypeLike

from jaxcam.errors import ConfigError, closest
from jaxcam.models.layers import linear
from jaxcam.models.policy import Obs, PolicySpec
from jaxcam.models.resnet import NORMS, RayEncoder, ResNet18, SmallEncoder, SmallRayEncoder
from jaxcam.rays import opengl_from_opencv, plucker

CONDITIONINGS = ("none", "token", "early", "late", "keypoints")

# Azimuth 0, elevation 45 degrees, 0.95 m from (0, 0, 0.8) in a world where the robot's base stands
# at (-0.56, 0, 0.912): the middle of the cameras of the paper.
_C = 0.5**0.5
NOMINAL_POSE = (
    (0.0, _C, -_C, 0.56 + 0.95 * _C),
    (1.0, 0.0, 0.0, 0.0),
    (0.0, -_C, -_C, 0.8 - 0.912 + 0.95 * _C),
    (0.0, 0.0, 0.0, 1.0),
)

IMAGENET_MEAN = np.array([0.485, 0.456, 0.406], np.float32)
IMAGENET_STD = np.array([0.229, 0.224, 0.225], np.float32)
FLATTEST = 0.1
"""A line less steep than this (z part of its unit direction) is not followed to a height."""


@dataclass(frozen=True)
class CameraConfig:
    """How a policy is told where its cameras are, and what it computes in."""

    conditioning: str = "late"
    """How the policy is told where its cameras are: none, token, early, late or keypoints."""
    twin_of: str = "late"
    """With conditioning none: the conditioning whose network is kept, fed with a fixed pose."""
    nominal_pose: tuple[tuple[float, ...], ...] = NOMINAL_POSE
    """That fixed pose, base_from_camera, OpenCV axes."""
    ray_convention: Literal["jaxcam", "authors"] = "jaxcam"
    """Order and pixel offset of the ray-map; keypoints always use "jaxcam"."""
    compute_dtype: str = "float32"
    """Arithmetic of the networks, float32 or bfloat16; weights and rays are always float32."""
    obs_steps: ClassVar[int] = 1
    """Observations the policy sees at once."""

    def __post_init__(self) -> None:
        """Refuse names that do not exist."""
        check_known(
            self,
            conditioning=CONDITIONINGS,
            twin_of=CONDITIONINGS,
            ray_convention=("jaxcam", "authors"),
            compute_dtype=("float32", "bfloat16"),
        )

    @property
    def network(self) -> str:
        """The conditioning whose network is built, which an image-only twin shares."""
        return self.twin_of if self.conditioning == "none" else self.conditioning

    @property
    def dtype(self) -> DTypeLike:
        """Type the networks compute in."""
        return jnp.dtype(self.compute_dtype)


def check_known(config: Any, **known: tuple[str, ...]) -> None:
    """Refuse settings whose value is not one of the known names."""
    for name, names in known.items():
        value = getattr(config, name)
        if value not in names:
            raise ConfigError(f"Unknown {name} '{value}'{closest(str(value), names)}.")


@dataclass(frozen=True)
class VisionConfig(CameraConfig):
    """Settings of the image encoder and of the conditioning."""

    encoder: str = "resnet18"
    """Image encoder: resnet18 (stride 32) or small (stride 4, cheap on a CPU)."""
    norm: str = "identity"
    """Norms of the ResNet: group, or frozen batch norms with the statistics of loaded weights
    (frozen) or with none (identity)."""
    encoder_depth: int = 2
    """Residual convolutions of the small encoder."""
    encoder_width: int = 512
    """Channels of the feature map that the encoders hand on."""
    image_scaling: str = "imagenet"
    """Scaling of colours: imagenet (mean and deviation), symmetric (-1 to 1) or unit (0 to 1)."""
    pool: str = "grid"
    """What becomes a token: every cell of the feature map (grid), or every one of the keypoints
    (keypoints), or only where these are in the image (softmax), as in Diffusion Policy."""
    keypoints: int = 32
    """Heat maps a view, when keypoints are pooled."""
    heat_gain: float = 25.0
    """Factor on heat maps before their softmax. At 1 all keypoints start in the image's middle, and
    training spends a thousand updates on getting them away from there."""
    keypoint_features: bool = False
    """Whether a ray keypoint also carries the features under its heat map, as keypoints without
    rays do unless the pool is softmax."""
    lift: bool = True
    """Whether a ray keypoint also carries the point of its ray at a height the network chooses."""

    def __post_init__(self) -> None:
        """Refuse names that do not exist."""
        super().__post_init__()
        check_known(
            self,
            encoder=("resnet18", "small"),
            norm=NORMS,
            image_scaling=("imagenet", "symmetric", "unit"),
            pool=("grid", "keypoints", "softmax"),
        )

    @property
    def pools_keypoints(self) -> bool:
        """Whether tokens are keypoints instead of cells of the feature map."""
        return self.pool != "grid" or self.network == "keypoints"


C = TypeVar("C", bound=CameraConfig)


def with_conditioning(config: C, conditioning: str) -> C:
    """The same policy, conditioned in another way.

    ``none`` gives the image-only twin of the conditioning that `config` has.
    """
    twin_of = config.network if conditioning == "none" else conditioning
    return replace(config, conditioning=conditioning, twin_of=twin_of)


def camera_poses(config: CameraConfig, obs: Obs) -> jax.Array:
    """The camera poses the policy is told, [B, V, 4, 4]: the true ones, or the fixed one."""
    poses = jnp.asarray(obs["base_from_camera"], jnp.float32)
    if config.conditioning == "none":
        return jnp.broadcast_to(jnp.asarray(config.nominal_pose, jnp.float32), poses.shape)
    return poses


def grid_rays(
    config: CameraConfig, obs: Obs, height: int, width: int, *, authors: bool = False
) -> jax.Array:
    """Ray-map of every view on a grid that covers its image, [B*V, height, width, 6]."""
    image_height, image_width = obs["image"].shape[-3:-1]
    scale = np.array([[width / image_width], [height / image_height], [1.0]], np.float32)
    poses = camera_poses(config, obs)
    convention = "jaxcam"
    if authors:
        poses, convention = opengl_from_opencv(poses), "authors"
    rays = plucker(obs["K"] * scale, poses, height, width, convention=convention)
    return rays.reshape(-1, height, width, 6)


def scale_images(config: VisionConfig, images: jax.Array) -> jax.Array:
    """Colours from 0..255 to what the encoder takes."""
    images = images.astype(jnp.float32)
    if config.image_scaling == "imagenet":
        images = (images / 255 - IMAGENET_MEAN) / IMAGENET_STD
    else:
        images = images / 127.5 - 1 if config.image_scaling == "symmetric" else images / 255
    return images.astype(config.dtype)


class Keypoints(NamedTuple):
    """What heat maps pool, each [N, k, ...]."""

    pixel: jax.Array
    """Expected position in the image, (x, y) in -1..1."""
    ray: jax.Array
    """Expected ray (d, m)."""
    features: jax.Array
    """Expected feature vector."""


def pool_keypoints(
    logits: jax.Array, rays: jax.Array, features: jax.Array, *, corners: bool = False
) -> Keypoints:
    """Expectations under spatial softmaxes.

    Args:
        logits: Heat maps before the softmax, float32 [N, h, w, k].
        rays: Ray-map on the same grid, [N, h, w, 6].
        features: Feature map, [N, h, w, C].
        corners: Whether positions of -1 and 1 are the middles of the outermost cells, as in
            Diffusion Policy, instead of the image's edges.

    Returns:
        Positions, rays and features. All rays of a camera meet in its centre, so an expected (d, m)
        is again a line through it, with a direction shorter than 1.
    """
    n, h, w, k = logits.shape
    weights = jax.nn.softmax(logits.reshape(n, h * w, k), axis=1)
    x, y = (2 * np.arange(size, dtype=np.float32) + 1 for size in (w, h))
    x, y = x / w - 1, y / h - 1
    if corners:
        x, y = (np.linspace(-1, 1, size, dtype=np.float32) for size in (w, h))
    pixel = np.stack(np.meshgrid(x, y), -1).reshape(h * w, 2)
    geometry = jnp.concatenate(
        [jnp.broadcast_to(pixel, (n, h * w, 2)), rays.reshape(n, h * w, 6)], -1
    )
    geometry = jnp.einsum("npk,npc->nkc", weights, geometry, precision="highest")
    features = features.reshape(n, h * w, -1)
    pooled = jnp.einsum("npk,npc->nkc", weights.astype(features.dtype), features)
    return Keypoints(geometry[..., :2], geometry[..., 2:], pooled)


def lift_to_height(ray: jax.Array, height: jax.Array) -> jax.Array:
    """The point of each line at a height.

    Args:
        ray: Lines (d, m), [..., 6]; d need not have length 1.
        height: Wanted z of the point, [...].

    Returns:
        Points [..., 3]. They always lie on their line; lines flatter than `FLATTEST` fall short of
        the height instead of running off to infinity.
    """
    d, m = ray[..., :3], ray[..., 3:]
    norm2 = jnp.sum(d * d, -1, keepdims=True)
    foot = jnp.cross(d, m) / norm2  # The line's nearest point to the origin.
    dz2 = jnp.maximum(d[..., 2] ** 2, FLATTEST**2 * norm2[..., 0])
    along = (height - foot[..., 2]) * d[..., 2] / dz2
    return foot + along[..., None] * d


class KeypointPool(nnx.Module):
    """Heat maps over a feature map, and what they pool, as one vector a keypoint."""

    def __init__(self, config: VisionConfig, *, rngs: nnx.Rngs):
        channels = config.encoder_width
        self.heat = linear(channels, config.keypoints, rngs=rngs, dtype=config.dtype)
        self.heat_gain = config.heat_gain
        self.with_rays = config.network == "keypoints"
        self.with_lift = self.with_rays and config.lift
        self.corners = config.pool == "softmax"
        plain = not self.with_rays and not self.corners
        self.with_features = config.keypoint_features or plain
        if self.with_lift:
            self.height = linear(channels, 1, rngs=rngs, dtype=jnp.float32)
            self.height_bias = nnx.Param(jnp.zeros(config.keypoints))
        self.width = 2 + 6 * self.with_rays + 3 * self.with_lift + channels * self.with_features

    def __call__(self, features: jax.Array, rays: jax.Array) -> jax.Array:
        """Map features [N, h, w, C] and rays [N, h, w, 6] to keypoints [N, k, width], float32."""
        logits = self.heat(features).astype(jnp.float32) * self.heat_gain
        points = pool_keypoints(logits, rays, features, corners=self.corners)
        parts = [points.pixel]
        if self.with_rays:
            parts.append(points.ray)
        if self.with_lift:
            height = self.height(points.features)[..., 0] + self.height_bias
            parts.append(lift_to_height(points.ray, height))
        if self.with_features:
            parts.append(points.features.astype(jnp.float32))
        return jnp.concatenate(parts, -1)


class Vision(nnx.Module):
    """Images and cameras to tokens.

    Attributes:
        tokens: Tokens a view.
        width: Numbers a token.
    """

    def __init__(self, config: VisionConfig, spec: PolicySpec, *, rngs: nnx.Rngs):
        self.config = config
        dtype, network, width = config.dtype, config.network, config.encoder_width
        early, late = network == "early", network == "late"
        if config.encoder == "small":
            self.image = SmallEncoder(
                6 * early, width, config.encoder_depth, rngs=rngs, dtype=dtype
            )
            self.rays = SmallRayEncoder(width, rngs=rngs, dtype=dtype) if late else None
            d_out = width
        else:
            self.image = ResNet18(3 + 6 * early, config.norm, rngs=rngs, dtype=dtype)
            self.rays = RayEncoder(rngs=rngs, dtype=dtype) if late else None
            d_out = ResNet18.channels
        stride = self.image.stride
        if config.encoder == "small" and (spec.height % stride or spec.width % stride):
            raise ConfigError(
                f"Images of {spec.height}x{spec.width} do not suit the {config.encoder} encoder: "
                f"both sides must be multiples of {stride}."
            )
        self.grid = -(-spec.height // stride), -(-spec.width // stride)
        # The small encoder already ends in the wanted width; only late fusion has to mix. Diffusion
        # Policy's heat maps are read off the ResNet as it is.
        as_it_is = config.encoder == "small" or (config.pool == "softmax" and d_out == width)
        mixes = late or not as_it_is
        self.mix = linear(d_out * (1 + late), width, rngs=rngs, dtype=dtype) if mixes else None
        self.pool = KeypointPool(config, rngs=rngs) if config.pools_keypoints else None
        self.tokens = self.grid[0] * self.grid[1] if self.pool is None else config.keypoints
        self.width = width if self.pool is None else self.pool.width

    def __call__(self, obs: Obs) -> jax.Array:
        """Tokens of every view, [B, V, tokens, width]."""
        batch, views = obs["image"].shape[:2]
        features = self._features(obs, obs["image"].reshape(-1, *obs["image"].shape[2:]))
        if self.pool is None:
            tokens = features.reshape(features.shape[0], -1, features.shape[-1])
        else:
            tokens = self.pool(features, grid_rays(self.config, obs, *self.grid))
        return tokens.reshape(batch, views, *tokens.shape[1:])

    def _features(self, obs: Obs, images: jax.Array) -> jax.Array:
        config = self.config
        x = scale_images(config, images)
        early, late = config.network == "early", config.network == "late"
        rays = None
        if early or late:
            # The small encoder takes rays on its grid: within one of its cells they barely bend.
            height, width = self.grid if config.encoder == "small" else images.shape[1:3]
            authors = config.ray_convention == "authors"
            rays = grid_rays(config, obs, height, width, authors=authors).astype(x.dtype)
        features = self.image(x, rays if early else None)
        if self.rays is not None and rays is not None:
            features = jnp.concatenate([features, self.rays(rays)], -1)
        return features if self.mix is None else self.mix(features)
