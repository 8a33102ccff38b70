"""What a policy is shown of worlds: pictures, their cameras, and what the robot feels."""

from typing import Any, NamedTuple

import numpy as np

from jaxcam.rays import invert
from jaxcam.rays.rotations import Array, array_namespace
from jaxcam.sim.painter import Painter
from jaxcam.sim.types import Start, View
from jaxcam.sim.world import World


class Cameras(NamedTuple):
    """The cameras that see each world."""

    K: Array
    """Intrinsics in pixels of the painter's pictures [B, V, 3, 3]."""
    world_from_camera: Array
    """Poses, OpenCV axes [B, V, 4, 4]."""
    base_from_camera: Array
    """The same in the robot's base frame, float32 [B, V, 4, 4]."""


class Instant(NamedTuple):
    """What an observation is made of."""

    qpos: Array
    grip_position: Array


def cameras_of(world: World, K: np.ndarray, world_from_camera: np.ndarray) -> Cameras:
    """Cameras that stand in a world.

    Args:
        world: The world.
        K: Intrinsics in pixels [B, V, 3, 3].
        world_from_camera: Poses, OpenCV axes [B, V, 4, 4].
    """
    world_from_camera = np.asarray(world_from_camera)
    base_from_camera = (invert(world.world_from_base) @ world_from_camera).astype(np.float32)
    return Cameras(np.asarray(K), world_from_camera, base_from_camera)


def observe(
    painter: Painter, sensed: Instant, start: Start, cameras: Cameras, active: Array
) -> dict[str, Array]:
    """An observation of each world, in the namespace of what is sensed.

    Args:
        painter: Draws the worlds.
        sensed: Where they are.
        start: How their episodes began.
        cameras: That see them.
        active: [B] worlds that are drawn; the others' pictures are black.

    Returns:
        `image` uint8 [B, V, H, W, 3], `K` float32 [B, V, 3, 3], `base_from_camera` float32
        [B, V, 4, 4] and `proprio` float32 [B, P].
    """
    world: World = painter.scene
    return {
        "image": _pictures(painter, sensed.qpos, start, cameras, active),
        "K": cameras.K.astype(np.float32),
        "base_from_camera": cameras.base_from_camera,
        "proprio": world.proprio(sensed.qpos, sensed.grip_position),
    }


def _pictures(draw: Painter, qpos: Array, start: Start, cameras: Cameras, active: Array) -> Array:
    """Pictures [B, V, H, W, 3] of the active worlds; the others' are black."""
    xp = array_namespace(qpos)
    count, views = cameras.K.shape[:2]
    shape = (count, views, draw.height, draw.width, 3)
    on_host = xp is np
    rows = np.flatnonzero(active) if on_host else np.arange(count)
    view = View(
        qpos=qpos[rows].repeat(views, 0),
        geom_size=start.geom_size[rows].repeat(views, 0),
        fixtures=start.fixtures[rows].repeat(views, 0),
        K=cameras.K[rows].reshape(-1, 3, 3),
        world_from_camera=cameras.world_from_camera[rows].reshape(-1, 4, 4),
    )
    if not on_host:
        compiled: Any = draw  # the painters of worlds that compiled engines step are, too
        traced = compiled.traced(view).reshape(shape)
        return xp.where(active[:, None, None, None, None], traced, 0)
    pictures = np.zeros(shape, np.uint8)
    pictures[rows] = draw.rgb(view).reshape(len(rows), *shape[1:])
    return pictures
