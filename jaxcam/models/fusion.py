"""How a policy is told where its cameras are: every way of conditioning, in one place.

A `Vision` module turns the images and cameras of an observation into tokens, and policies build on
those. The ways:

- ``token``: the flattened camera pose, linearly projected, is one more token.
- ``early``: the ray-map joins the image as six more input channels.
- ``late``: the ray-map has an encoder of its own; the two feature maps are concatenated and mixed.
- ``keypoints``: heat maps over the image pool the ray-map, so that a keypoint is a line in space.
- ``warp``: no rays; the image is seen anew from one view, as if all in it lay on the table.
- ``prope``, ``gta``, ``ray_rope``: no rays either; attention knows the frame of each of its tokens,
  and those without a camera are in the base's (`jaxcam.models.token_frames` says what and why).
- ``none``: the camera pose is hidden. The network is that of ``twin_of``, fed with the pose of one
  camera that is always the same, so that the two differ in nothing but what they are told. With
  ``twin_of="none"`` there is no ray path at all.
"""

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from jaxcam.errors import ConfigError
from jaxcam.models.conditioning import CameraConfig, VisionConfig
from jaxcam.models.keypoints import KeypointPool
from jaxcam.models.layers import linear
from jaxcam.models.policy import Obs, PolicySpec
from jaxcam.models.resnet import (
    RayEncoder,
    ResNet18,
    SmallEncoder,
    SmallRayEncoder,
    space_to_depth,
)
from jaxcam.models.token_frames import TokenFrames, camera_projections, cell_angles, ray_angles
from jaxcam.models.warp import plane_points, warped
from jaxcam.rays import opengl_from_opencv, plucker

IMAGENET_MEAN = np.array([0.485, 0.456, 0.406], np.float32)
IMAGENET_STD = np.array([0.229, 0.224, 0.225], np.float32)


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
    rays = plucker(
        obs["K"] * scale, poses, height, width, convention=convention,
        distortion=obs.get("distortion"),
    )  # fmt: skip
    return rays.reshape(-1, height, width, 6)


def token_frames(
    config: CameraConfig, obs: Obs, grid: tuple[int, int], channels: int, *, cells: bool = True
) -> TokenFrames | None:
    """The frames of image tokens, for attention whose sequences begin with them.

    Args:
        config: Settings.
        obs: Images and cameras.
        grid: Rows and columns of a view's tokens, which cover its image.
        channels: Of a head of attention, a multiple of 8.
        cells: Whether tokens are told apart by their column and row, too.

    Returns:
        None where the way of conditioning asks for none.
    """
    if not config.frames_tokens:
        return None
    height, width = obs["image"].shape[-3:-1]
    poses, pairs = camera_poses(config, obs), channels // 8
    batch, count = poses.shape[0], poses.shape[1] * grid[0] * grid[1]
    projection, angles = None, []
    if config.network == "ray_rope":
        rays = grid_rays(config, obs, *grid).reshape(batch, count, 6)
        angles.append(ray_angles(rays, pairs))
    else:
        K = jnp.asarray(obs["K"], jnp.float32) if config.network == "prope" else None
        projection = camera_projections(K, poses, height, width)
    if cells:
        own = np.tile(cell_angles(*grid, pairs), (poses.shape[1], 1))
        angles.append(jnp.broadcast_to(own, (batch, *own.shape)))
    if not angles:
        return TokenFrames(count, projection)
    both = jnp.concatenate(angles, -1)
    return TokenFrames(count, projection, both.reshape(batch, count, 1, -1, pairs))


def canonical_images(config: CameraConfig, obs: Obs) -> jax.Array:
    """What of the table's plane the view of `nominal_pose` would see, float32 [B, V, H, W, 3]."""
    height, width = obs["image"].shape[-3:-1]
    return warped(obs, camera_poses(config, obs), *table_view(config, height, width))


def table_view(config: CameraConfig, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """What the pixels of that view see, and which of them see anything: see `plane_points`."""
    view = np.array(config.nominal_pose)
    return plane_points(view, config.warp_fovy_deg, config.warp_height, height, width)


def scale_images(config: VisionConfig, images: jax.Array) -> jax.Array:
    """Colours from 0..255 to what the encoder takes."""
    images = images.astype(jnp.float32)
    if config.image_scaling == "imagenet":
        images = (images / 255 - IMAGENET_MEAN) / IMAGENET_STD
    else:
        images = images / 127.5 - 1 if config.image_scaling == "symmetric" else images / 255
    return images.astype(config.dtype)


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
        if network == "warp":
            table_view(config, spec.height, spec.width)  # refuses a view that sees no table
        self.cells = -(-spec.height // stride), -(-spec.width // stride)
        # The small encoder already ends in the wanted width; only late fusion has to mix. Diffusion
        # Policy's heat maps are read off the ResNet as it is.
        as_it_is = config.encoder == "small" or (config.pool == "softmax" and d_out == width)
        mixes = late or not as_it_is
        self.mix = linear(d_out * (1 + late), width, rngs=rngs, dtype=dtype) if mixes else None
        self.pool = KeypointPool(config, rngs=rngs) if config.pools_keypoints else None
        self.fold = config.fold if self.pool is None else 1
        if self.cells[0] % self.fold or self.cells[1] % self.fold:
            raise ConfigError(
                f"fold {self.fold} does not divide the {self.cells[0]}x{self.cells[1]} cells of "
                f"images of {spec.height}x{spec.width}."
            )
        self.grid = self.cells[0] // self.fold, self.cells[1] // self.fold
        self.tokens = self.grid[0] * self.grid[1] if self.pool is None else config.keypoints
        self.width = width * self.fold**2 if self.pool is None else self.pool.width

    def __call__(self, obs: Obs) -> jax.Array:
        """Tokens of every view, [B, V, tokens, width]."""
        return self.look(obs)[0]

    def look(self, obs: Obs) -> tuple[jax.Array, jax.Array | None]:
        """Tokens of every view, and the heat maps of keypoints, [B*V, h, w, k], where it has any.

        Those are as they are before the softmax.
        """
        images = obs["image"]
        batch, views = images.shape[:2]
        if self.config.network == "warp":
            images = canonical_images(self.config, obs)
        features = self._features(obs, images.reshape(-1, *images.shape[2:]))
        heat = None
        if self.pool is None:
            features = space_to_depth(features, self.fold) if self.fold > 1 else features
            tokens = features.reshape(features.shape[0], -1, features.shape[-1])
        else:
            tokens, heat = self.pool(features, grid_rays(self.config, obs, *self.cells))
        return tokens.reshape(batch, views, *tokens.shape[1:]), heat

    def _features(self, obs: Obs, images: jax.Array) -> jax.Array:
        config = self.config
        x = scale_images(config, images)
        early, late = config.network == "early", config.network == "late"
        rays = None
        if early or late:
            # The small encoder takes rays on its grid: within one of its cells they barely bend.
            height, width = self.cells if config.encoder == "small" else images.shape[1:3]
            authors = config.ray_convention == "authors"
            rays = grid_rays(config, obs, height, width, authors=authors).astype(x.dtype)
        features = self.image(x, rays if early else None)
        if self.rays is not None and rays is not None:
            features = jnp.concatenate([features, self.rays(rays)], -1)
        return features if self.mix is None else self.mix(features)
