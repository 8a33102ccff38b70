"""What a policy is shown of worlds: pictures, their cameras, and what the robot feels."""

from typing import Any, NamedTuple

import numpy as np

from jaxcam.config.names import RayFrame
from jaxcam.rays import invert
from jaxcam.rays.lens import PACKED
from jaxcam.rays.rotations import Array, array_namespace, matmul, matrix_from_rotvec, rigid
from jaxcam.sim.controllers import CONTROL_HZ
from jaxcam.sim.painter import Painter
from jaxcam.sim.ray_frames import frame_from_base, grip_in_base, in_ray_frame
from jaxcam.sim.types import Start, State, View
from jaxcam.sim.world import World


class Told(NamedTuple):
    """What a policy is told of its cameras where that is not what is so; None is what is so."""

    K: Array | None = None
    """Intrinsics [B, V, 3, 3]; of a lens it is told nothing then."""
    base_from_camera: Array | None = None
    """Poses in the robot's base frame at the episode's start [B, V, 4, 4]."""
    drift: Array | None = None
    """How they go on from there [B, V, 6]: a rotation vector (rad/s) in the camera's axes, and a
    velocity (m/s) in the base's."""


class Cameras(NamedTuple):
    """The cameras that see each world."""

    K: Array
    """Intrinsics in pixels of the painter's pictures [B, V, 3, 3]."""
    world_from_camera: Array
    """Poses, OpenCV axes [B, V, 4, 4]."""
    base_from_camera: Array
    """The same in the robot's base frame as policies are told them, float32 [B, V, 4, 4]."""
    lens: Array | None = None
    """Coefficients from `jaxcam.rays.lens.pack` [B, V, 9]; None where all are pinholes."""
    claimed: Told = Told()
    """What else policies are told that is not so."""


class Instant(NamedTuple):
    """What an observation is made of."""

    qpos: Array
    grip_position: Array
    """In the world (m) [B, 3]."""
    grip_rotation: Array
    """Its axes in the world [B, 3, 3]."""
    taken: Array
    """Control steps since the episode's start, of all or of each [B]."""

    @classmethod
    def of(cls, state: State, taken: Array) -> "Instant":
        """What there is of a state.

        Args:
            state: Of the worlds.
            taken: Control steps so far.
        """
        return cls(state.qpos, state.grip_position, state.grip_rotation, taken)


def cameras_of(
    world: World,
    K: np.ndarray,
    world_from_camera: np.ndarray,
    lens: np.ndarray | None = None,
    claimed: Told | None = None,
) -> Cameras:
    """Cameras that stand in a world.

    Args:
        world: The world.
        K: Intrinsics in pixels [B, V, 3, 3].
        world_from_camera: Poses, OpenCV axes [B, V, 4, 4].
        lens: Packed coefficients [B, V, 9]; None where all are pinholes.
        claimed: What policies are told that is not so.
    """
    world_from_camera, claimed = np.asarray(world_from_camera), claimed or Told()
    base_from_camera = claimed.base_from_camera
    if base_from_camera is None:
        base_from_camera = (invert(world.world_from_base) @ world_from_camera).astype(np.float32)
    return Cameras(np.asarray(K), world_from_camera, base_from_camera, lens, claimed)


def observe(
    painter: Painter,
    sensed: Instant,
    start: Start,
    cameras: Cameras,
    active: Array,
    ray_frame: RayFrame = "base",
) -> dict[str, Array]:
    """An observation of each world, in the namespace of what is sensed.

    Args:
        painter: Draws the worlds.
        sensed: Where they are.
        start: How their episodes began.
        cameras: That see them.
        active: [B] worlds that are drawn; the others' pictures are black.
        ray_frame: In which frame the policy wants its cameras.

    Returns:
        `image` uint8 [B, V, H, W, 3], `K` float32 [B, V, 3, 3], `base_from_camera` float32
        [B, V, 4, 4] (from the ray frame, if that is another) and `proprio` float32 [B, P]; with
        lenses also `distortion` float32 [B, V, 9].
    """
    world: World = painter.scene
    claimed = cameras.claimed
    poses = cameras.base_from_camera
    if claimed.drift is not None:
        poses = _drifted(poses, claimed.drift, sensed.taken / CONTROL_HZ)
    if ray_frame != "base":
        grip = grip_in_base(world.world_from_base, sensed.grip_position, sensed.grip_rotation)
        poses = in_ray_frame(poses, frame_from_base(ray_frame, world, *grip)[:, None])
    shown = {
        "image": _pictures(painter, sensed.qpos, start, cameras, active),
        "K": (cameras.K if claimed.K is None else claimed.K).astype(np.float32),
        "base_from_camera": poses,
        "proprio": world.proprio(sensed.qpos, sensed.grip_position),
    }
    if cameras.lens is not None and claimed.K is None:
        shown["distortion"] = cameras.lens.astype(np.float32)
    return shown


def _drifted(poses: Array, drift: Array, seconds: Array) -> Array:
    """Poses [B, V, 4, 4] that have gone on for some time, of all episodes or of each [B]."""
    xp = array_namespace(seconds)
    way = drift * xp.asarray(seconds, np.float32).reshape(-1, 1, 1)
    turned = matmul(poses[..., :3, :3], matrix_from_rotvec(way[..., :3]))
    return rigid(turned, poses[..., :3, 3] + way[..., 3:]).astype(np.float32)


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
        lens=None if cameras.lens is None else cameras.lens[rows].reshape(-1, PACKED),
    )
    if not on_host:
        compiled: Any = draw  # the painters of worlds that compiled engines step are, too
        traced = compiled.traced(view).reshape(shape)
        return xp.where(active[:, None, None, None, None], traced, 0)
    pictures = np.zeros(shape, np.uint8)
    pictures[rows] = draw.rgb(view).reshape(len(rows), *shape[1:])
    return pictures
