"""Cameras as rays: Plücker maps, camera records, lenses, conversions, and pose sampling.

Loads nothing but JAX and NumPy, so that any project can use it on its own.
"""

from jaxcam.rays._camera import Camera
from jaxcam.rays._checks import ROTATION_TOLERANCE, check_pose
from jaxcam.rays._convert import (
    from_maniskill,
    from_maniskill_gl,
    from_mujoco,
    from_mujoco_quat,
    from_robosuite,
    invert,
    opencv_from_opengl,
    opencv_from_sapien,
    opengl_from_opencv,
    read_pose_file,
    sapien_from_opencv,
    to_maniskill,
    to_mujoco,
    to_mujoco_quat,
    write_pose_file,
)
from jaxcam.rays._plucker import patch_rays, plucker
from jaxcam.rays._poses import (
    POSE_RANGES,
    PoseRanges,
    look_at,
    perturb,
    sample_poses,
    spherical,
    stair,
    stair_cameras,
)

__all__ = [
    "POSE_RANGES",
    "ROTATION_TOLERANCE",
    "Camera",
    "PoseRanges",
    "check_pose",
    "from_maniskill",
    "from_maniskill_gl",
    "from_mujoco",
    "from_mujoco_quat",
    "from_robosuite",
    "invert",
    "look_at",
    "opencv_from_opengl",
    "opencv_from_sapien",
    "opengl_from_opencv",
    "patch_rays",
    "perturb",
    "plucker",
    "read_pose_file",
    "sample_poses",
    "sapien_from_opencv",
    "spherical",
    "stair",
    "stair_cameras",
    "to_maniskill",
    "to_mujoco",
    "to_mujoco_quat",
    "write_pose_file",
]
