"""Pictures seen anew from one view, as if all that is in them lay on the table.

A pixel of the view is a point of the table's plane, and the camera says where in its picture that
is: a homography, by K and pose. What stands above the plane leans away from the camera, as a shadow
does. The view does not depend on the picture's K: of a crop, less is seen, at the same place.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from jaxcam.errors import ConfigError
from jaxcam.models.policy import Obs
from jaxcam.rays import Camera
from jaxcam.rays.intrinsics import intrinsics

HORIZON = 1e-3
"""Rays of the view that go down by less than this, as a share of their length, see no table."""


def plane_points(
    base_from_view: np.ndarray, fovy_deg: float, table: float, height: int, width: int
) -> tuple[np.ndarray, np.ndarray]:
    """What the pixels of a view see of a level plane.

    Args:
        base_from_view: Pose of the view, OpenCV axes [4, 4].
        fovy_deg: Its vertical field of view.
        table: Height of the plane in the base frame, metres.
        height: Rows of the view.
        width: Its columns.

    Returns:
        Points in the base frame, metres [height, width, 3], and which pixels see the plane.

    Raises:
        ConfigError: None does.
    """
    K = intrinsics(fovy_deg, height, width)
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    x, y = (column - K[0, 2]) / K[0, 0], (row - K[1, 2]) / K[1, 1]
    rays = np.stack([x, y, np.ones_like(x)], -1) @ base_from_view[:3, :3].T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    above = base_from_view[2, 3] - table
    sees = -rays[..., 2] * np.sign(above) > HORIZON
    if not sees.any():
        raise ConfigError(
            f"warp: the view of nominal_pose does not see the plane {table:g} m over the base that "
            "warp_height names. Choose another of the two."
        )
    along = np.where(sees, -above / np.where(sees, rays[..., 2], 1), 0)
    return base_from_view[:3, 3] + along[..., None] * rays, sees


def warped(
    obs: Obs, base_from_camera: jax.Array, points: np.ndarray, sees: np.ndarray
) -> jax.Array:
    """Pictures as a view sees them.

    Args:
        obs: With `image` [B, V, H, W, 3], `K` and perhaps `distortion`.
        base_from_camera: Poses that are believed [B, V, 4, 4].
        points: What the view's pixels see in the base frame [h, w, 3], from `plane_points`.
        sees: Which of them see anything [h, w].

    Returns:
        Float32 [B, V, h, w, 3], bilinear; black where the picture does not reach.
    """
    image = jnp.asarray(obs["image"], jnp.float32)
    cameras = Camera(
        obs["K"], base_from_camera, *image.shape[-3:-1], distortion=obs.get("distortion")
    )
    pixels, depth = cameras.project(jnp.asarray(points[None, None], jnp.float32))
    # The centre of pixel (0, 0), where its sample lies, is at (0.5, 0.5); -1 is outside.
    places = jnp.where((depth > 0)[..., None] & sees[..., None], pixels - 0.5, -1.0)

    def resampled(picture: jax.Array, places: jax.Array) -> jax.Array:
        channel = functools.partial(
            jax.scipy.ndimage.map_coordinates, coordinates=[places[..., 1], places[..., 0]], order=1
        )
        return jax.vmap(channel, in_axes=-1, out_axes=-1)(picture)

    return jax.vmap(jax.vmap(resampled))(image, places)
