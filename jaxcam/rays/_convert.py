"""Camera poses to and from other people's conventions. The only place that knows them.

`world_from_camera` is `[..., 4, 4]` in OpenCV axes (x right, y down, z forward) unless a name says
otherwise. Functions keep NumPy (and its precision) under NumPy and JAX under JAX.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np

from jaxcam.errors import CameraError
from jaxcam.rays._arrays import Array, array_namespace, as_float, matmul, rigid
from jaxcam.rays._checks import check_pose
from jaxcam.rays.rotations import matrix_from_quaternion, quaternion_from_matrix

# Columns: the axes of the foreign camera frame, in OpenCV axes.
_GL = np.diag([1.0, -1.0, -1.0, 1.0])
# SAPIEN: x forward, y left, z up.
_SAPIEN = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])


def invert(transform: Array) -> Array:
    """Inverse of a rigid transform, `[..., 4, 4]`: camera-to-world to world-to-camera and back."""
    xp = array_namespace(transform)
    transform = as_float(transform, xp)
    rotation_t = xp.swapaxes(transform[..., :3, :3], -1, -2)
    return rigid(rotation_t, -matmul(rotation_t, transform[..., :3, 3:])[..., 0])


def opencv_from_opengl(world_from_camera: Array) -> Array:
    """Pose in OpenCV axes of a camera given in OpenGL axes (y up, looking along -z)."""
    return _change_axes(world_from_camera, _GL)


def opengl_from_opencv(world_from_camera: Array) -> Array:
    """Pose in OpenGL axes (y up, looking along -z) of a camera given in OpenCV axes."""
    return _change_axes(world_from_camera, _GL)


def opencv_from_sapien(world_from_camera: Array) -> Array:
    """Pose in OpenCV axes of a SAPIEN pose (x forward, y left, z up), as in `CameraConfig`."""
    return _change_axes(world_from_camera, _SAPIEN.T)


def sapien_from_opencv(world_from_camera: Array) -> Array:
    """Pose to place a SAPIEN or ManiSkill camera with (x forward, y left, z up)."""
    return _change_axes(world_from_camera, _SAPIEN)


def from_mujoco(cam_xpos: Array, cam_xmat: Array) -> Array:
    """Pose from MuJoCo's `data.cam_xpos` and `data.cam_xmat`.

    Args:
        cam_xpos: `[..., 3]`.
        cam_xmat: `[..., 9]` as in `mujoco.MjData`, or `[..., 3, 3]` as in MJX.
    """
    xp = array_namespace(cam_xpos, cam_xmat)
    cam_xpos, cam_xmat = as_float(cam_xpos, xp), as_float(cam_xmat, xp)
    if cam_xmat.shape[-2:] != (3, 3):
        cam_xmat = cam_xmat.reshape(*cam_xmat.shape[:-1], 3, 3)
    return opencv_from_opengl(rigid(cam_xmat, cam_xpos))


def to_mujoco(world_from_camera: Array) -> tuple[Array, Array]:
    """`cam_xpos` `[..., 3]` and `cam_xmat` `[..., 3, 3]` of a pose (`MjData`: `[..., 9]`)."""
    pose = opengl_from_opencv(world_from_camera)
    return pose[..., :3, 3], pose[..., :3, :3]


def from_mujoco_quat(cam_pos: Array, cam_quat: Array) -> Array:
    """Pose from a camera's MJCF `pos` and `quat` (w, x, y, z), or `model.cam_pos`, `cam_quat`.

    MuJoCo gives these relative to the camera's parent body: the result is `body_from_camera`.

    Args:
        cam_pos: `[..., 3]`.
        cam_quat: `[..., 4]`; normalised here, as MuJoCo's compiler does.
    """
    xp = array_namespace(cam_pos, cam_quat)
    q = as_float(cam_quat, xp)
    q = q / xp.linalg.norm(q, axis=-1, keepdims=True)
    return opencv_from_opengl(rigid(matrix_from_quaternion(q), as_float(cam_pos, xp)))


def to_mujoco_quat(body_from_camera: Array) -> tuple[Array, Array]:
    """MJCF `pos` `[..., 3]` and `quat` `[..., 4]` (w, x, y, z; w >= 0) of a pose in its body."""
    pose = opengl_from_opencv(body_from_camera)
    return pose[..., :3, 3], quaternion_from_matrix(pose[..., :3, :3])


def from_robosuite(extrinsic: Array) -> Array:
    """Pose from robosuite's `get_camera_extrinsic_matrix(sim, name)`.

    Despite its name that function returns the camera's pose in OpenCV axes, which is what jaxcam
    uses: nothing changes. `get_camera_intrinsic_matrix` needs no conversion either. Images do:
    robosuite's default `IMAGE_CONVENTION = "opengl"` stores the bottom row first; use
    `image[::-1]` with both matrices.
    """
    return as_float(extrinsic, array_namespace(extrinsic))


def from_maniskill(extrinsic_cv: Array) -> Array:
    """Pose from ManiSkill's `extrinsic_cv`, which maps world to camera, `[..., 3 or 4, 4]`."""
    xp = array_namespace(extrinsic_cv)
    extrinsic = as_float(extrinsic_cv, xp)
    if extrinsic.shape[-2:] not in ((3, 4), (4, 4)):
        raise CameraError(
            f"extrinsic_cv has the wrong shape: expected [..., 3, 4] or [..., 4, 4], got "
            f"{list(extrinsic.shape)}."
        )
    return invert(rigid(extrinsic[..., :3, :3], extrinsic[..., :3, 3]))


def from_maniskill_gl(cam2world_gl: Array) -> Array:
    """Pose from ManiSkill's `cam2world_gl`."""
    return opencv_from_opengl(cam2world_gl)


def to_maniskill(world_from_camera: Array) -> tuple[Array, Array]:
    """`extrinsic_cv` `[..., 3, 4]` and `cam2world_gl` `[..., 4, 4]` of a pose."""
    return invert(world_from_camera)[..., :3, :], opengl_from_opencv(world_from_camera)


def read_pose_file(path: str | Path) -> tuple[np.ndarray, dict[str, Any]]:
    """Read a pose file of the paper's authors.

    The file is JSON, `{"config": {...}, "poses": [4x4, ...]}`, camera-to-world in OpenGL axes.

    Args:
        path: The file.

    Returns:
        Poses `[count, 4, 4]` in OpenCV axes, float64, and the config as it stands in the file.

    Raises:
        CameraError: If the file is not of this form or a pose is impossible, or it is none: a
            device or a pipe may never end.
    """
    path = Path(path)
    if path.exists() and not path.is_file():
        raise CameraError(f"{path} is no file: expected JSON with 'poses'.")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CameraError(f"{path} cannot be read: {error.strerror}.") from error
    except (ValueError, RecursionError) as error:
        raise CameraError(f"{path} is not JSON ({error}). Likely cause: a cut download.") from None
    fields = cast(dict[str, Any], content) if isinstance(content, dict) else {}
    if not isinstance(fields.get("poses"), list):
        got = list(fields) if isinstance(content, dict) else type(content).__name__
        raise CameraError(f"{path}: expected an object with a list 'poses', found {got}.")
    config = fields.get("config", {})
    if not isinstance(config, dict):
        raise CameraError(f"{path}: 'config' must be an object, found {type(config).__name__}.")
    try:
        poses = np.asarray(fields["poses"], np.float64)
    except (TypeError, ValueError, OverflowError):
        raise CameraError(f"{path}: 'poses' must be a list of 4x4 matrices of numbers.") from None
    if poses.ndim != 3:
        raise CameraError(f"{path}: expected [count, 4, 4] poses, got {list(poses.shape)}.")
    check_pose(f"{path} pose", poses)
    return opencv_from_opengl(poses), cast(dict[str, Any], config)


def write_pose_file(
    path: str | Path, world_from_camera: Array, config: Mapping[str, Any] | None = None
) -> None:
    """Write poses as a file the authors' code reads; see `read_pose_file`.

    Args:
        path: The file; overwritten.
        world_from_camera: Poses `[count, 4, 4]` in OpenCV axes.
        config: Anything JSON can hold about where the poses come from.
    """
    poses = np.asarray(world_from_camera, np.float64)
    if poses.ndim != 3:
        raise CameraError(f"expected [count, 4, 4] poses to write, got {list(poses.shape)}.")
    check_pose("pose", poses)
    content = {"config": dict(config or {}), "poses": opengl_from_opencv(poses).tolist()}
    Path(path).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _change_axes(world_from_camera: Array, axes: np.ndarray) -> Array:
    xp = array_namespace(world_from_camera)
    pose = as_float(world_from_camera, xp)
    return matmul(pose, xp.asarray(axes, pose.dtype))
