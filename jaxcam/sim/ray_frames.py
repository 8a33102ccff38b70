"""Frames that a policy may be told its rays in, instead of the robot's base.

    base         axes and origin of the robot's base
    world        of the world: the origin is on the table's height in ManiSkill, on the floor below
                 the table's middle in robosuite
    grip         of the grip, which moves with it
    about_grip   the base's axes, moments about the grip
    about_table  the base's axes, moments about the point of the table above the world's origin

A rigid transform of the cameras is all it takes: a ray-map of poses in a frame has its directions
in that frame's axes and its moments about that frame's origin.
"""

import numpy as np

from jaxcam.config.names import RayFrame
from jaxcam.rays.rotations import Array, array_namespace, matmul, rigid
from jaxcam.sim.world import World


def frame_from_base(
    name: RayFrame, world: World, grip_position: Array, grip_rotation: Array
) -> Array:
    """The transform from the base to a frame, float32 [..., 4, 4].

    Args:
        name: Of the frame.
        world: Where robot and table stand.
        grip_position: Of the grip, in the base (m) [..., 3].
        grip_rotation: Its axes in the base [..., 3, 3].
    """
    xp = array_namespace(grip_position)
    base, shape = world.world_from_base, grip_position.shape
    axes, origin = xp.broadcast_to(xp.eye(3), (*shape, 3)), xp.zeros(shape)
    if name == "world":
        return xp.broadcast_to(xp.asarray(base, np.float32), (*shape[:-1], 4, 4))
    if name == "grip":
        axes = xp.swapaxes(grip_rotation, -1, -2)
    if name in ("grip", "about_grip"):
        origin = grip_position
    if name == "about_table":
        top = np.array([0.0, 0.0, world.table_top])
        origin = xp.broadcast_to(xp.asarray((top - base[:3, 3]) @ base[:3, :3]), shape)
    return rigid(axes, -matmul(axes, origin[..., None])[..., 0]).astype(np.float32)


def grip_in_base(
    world_from_base: np.ndarray, position: Array, rotation: Array
) -> tuple[Array, Array]:
    """Position [..., 3] and axes [..., 3, 3] of the grip in the base, from those in the world.

    Args:
        world_from_base: Pose of the base [4, 4].
        position: Of the grip, in the world (m) [..., 3].
        rotation: Its axes in the world [..., 3, 3].
    """
    axes = world_from_base[:3, :3]
    return (position - world_from_base[:3, 3]) @ axes, matmul(axes.T, rotation)


def in_ray_frame(base_from_camera: Array, frame_from_base: Array) -> Array:
    """Cameras [..., 4, 4] of the base in another frame, float32.

    Args:
        base_from_camera: Poses [..., 4, 4].
        frame_from_base: Transforms whose leading axes broadcast against those of the poses.
    """
    return matmul(frame_from_base, base_from_camera).astype(np.float32)
