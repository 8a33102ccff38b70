"""Every public function's precision: kept from its arguments or as documented, x64 or not."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rays_oracle import random_camera

from jaxcam import rays
from jaxcam.rays import Camera, lens, rotations
from jaxcam.rays.intrinsics import intrinsics

POSE = random_camera(0, batch=(2,)).world_from_camera
K = np.array([[9.0, 0, 4], [0, 9, 3], [0, 0, 1]])
LENS = np.array([-0.1, 0.02, 1e-3, 1e-3, 0.0])
POINTS = np.ones((2, 5, 3))


def camera(a):
    return Camera(a(K), a(POSE), 6, 8, a(LENS))


# Each takes `a`, which makes an array of the precision and library under test.
KEPT = {
    "from_maniskill": lambda a: rays.from_maniskill(a(POSE[:, :3])),
    "from_maniskill_gl": lambda a: rays.from_maniskill_gl(a(POSE)),
    "from_mujoco": lambda a: rays.from_mujoco(a(POSE[:, :3, 3]), a(POSE[:, :3, :3])),
    "from_mujoco_quat": lambda a: rays.from_mujoco_quat(a([1, 2, 3]), a([1, 0, 2, 0])),
    "from_robosuite": lambda a: rays.from_robosuite(a(POSE)),
    "invert": lambda a: rays.invert(a(POSE)),
    "look_at": lambda a: rays.look_at(a([1, 1, 1]), a([0, 0, 0])),
    "opencv_from_opengl": lambda a: rays.opencv_from_opengl(a(POSE)),
    "opencv_from_sapien": lambda a: rays.opencv_from_sapien(a(POSE)),
    "opengl_from_opencv": lambda a: rays.opengl_from_opencv(a(POSE)),
    "sapien_from_opencv": lambda a: rays.sapien_from_opencv(a(POSE)),
    "spherical": lambda a: rays.spherical(a(POSE), (0.0, 0.0, 0.8)),
    "to_maniskill": lambda a: rays.to_maniskill(a(POSE)),
    "to_mujoco": lambda a: rays.to_mujoco(a(POSE)),
    "to_mujoco_quat": lambda a: rays.to_mujoco_quat(a(POSE)),
    "Camera.from_fovy": lambda a: Camera.from_fovy(a([0.5, 0.6]), 6, 8),
    "Camera.centre": lambda a: camera(a).centre,
    "Camera.fovy": lambda a: camera(a).fovy,
    "Camera.project": lambda a: camera(a).project(a(POINTS)),
    "Camera.unproject": lambda a: camera(a).unproject(a(np.ones((2, 6, 8)))),
    "Camera.crop": lambda a: camera(a).crop(1, 2, 3, 4),
    "Camera.resize": lambda a: camera(a).resize(12, 9),
    "Camera.flip_horizontal": lambda a: camera(a).flip_horizontal(),
    "Camera.in_frame": lambda a: camera(a).in_frame(a(POSE)),
    "Camera.validate": lambda a: camera(a).validate(),
    "lens.distort": lambda a: lens.distort(a([0.1]), a([0.2]), a(LENS), "opencv")[:2],
    "lens.normalised": lambda a: lens.normalised(a(K), a([1]), a([2])),
    "lens.pack": lambda a: lens.pack(a(LENS[:4]), "fisheye"),
    "lens.sight_lines": lambda a: (
        lens.sight_lines(a([0.1]), a([0.2]), a(LENS), "opencv"),
        lens.sight_lines(a([0.1]), a([0.2]), a(LENS[:4]), "fisheye"),
        lens.sight_lines(a([0.1]), a([0.2]), lens.pack(a(LENS)), "opencv"),
    ),
    "rotations.matrix_from_quaternion": lambda a: rotations.matrix_from_quaternion(a([1, 0, 0, 0])),
    "rotations.matrix_from_rotvec": lambda a: rotations.matrix_from_rotvec(a([0.1, 0.2, 0.3])),
    "rotations.nearest_rotation": lambda a: rotations.nearest_rotation(a(POSE[:, :3, :3])),
    "rotations.quaternion_from_matrix": lambda a: rotations.quaternion_from_matrix(
        a(POSE[:, :3, :3])
    ),
    "rotations.rotvec_from_matrix": lambda a: rotations.rotvec_from_matrix(a(POSE[:, :3, :3])),
    "rotations.skew": lambda a: rotations.skew(a([1, 2, 3])),
}
FIXED = {
    "plucker": ("float32", lambda a: rays.plucker(a(K), a(POSE), 6, 8, distortion=a(LENS))),
    "patch_rays": ("float32", lambda a: rays.patch_rays(a(K), a(POSE), 6, 8, 2)),
    "perturb": ("float32", lambda a: rays.perturb(a(POSE), jax.random.key(0), 0.1, a([0.1, 0.2]))),
    "sample_poses": ("float64", lambda a: rays.sample_poses(rays.POSE_RANGES["robosuite"], 2, 1)),
    "stair": ("int64", lambda a: rays.stair(5, 3, 1)),
    "Camera.plucker": ("float32", lambda a: camera(a).plucker()),
    "Camera.pixel_centres": ("float32", lambda a: camera(a).pixel_centres()),
    "Camera.has_ray": ("bool", lambda a: camera(a).has_ray()),
    "lens.valid": ("bool", lambda a: lens.valid(a(K), 6, 8, a(LENS))),
    "intrinsics": ("float64", lambda a: intrinsics(45, 8)),
}
WITHOUT_ARRAYS = {
    "check_pose",
    "read_pose_file",  # float64 by test_convert
    "stair_cameras",
    "write_pose_file",
    "Camera.batch",
    "lens.check_distortion",
    "rotations.array_namespace",
    "rotations.matmul",
}


def public():
    """Names of all functions that a user can call, methods of the record included."""
    names = {n for n in rays.__all__ if inspect.isfunction(getattr(rays, n))} | {"intrinsics"}
    for module in (lens, rotations):
        name = module.__name__.rpartition(".")[2]
        own = inspect.getmembers(module, inspect.isfunction)
        names |= {f"{name}.{n}" for n, f in own if n[0] != "_" and f.__module__ == module.__name__}
    fields = set(Camera.__dataclass_fields__)
    return names | {f"Camera.{n}" for n in vars(Camera) if n[0] != "_" and n not in fields}


def test_each_public_function_is_here():
    assert public() - WITHOUT_ARRAYS == set(KEPT) | set(FIXED)


@pytest.mark.parametrize("x64", [False, True])
@pytest.mark.parametrize("library", [np, jnp])
@pytest.mark.parametrize("given", ["float32", "float64"])
def test_precision(given, library, x64):
    if library is jnp and given == "float64" and not x64:
        pytest.skip("JAX has no float64 then")
    with jax.enable_x64(x64):

        def array(values):
            return library.asarray(np.asarray(values), dtype=given)

        def check():
            for name, call in KEPT.items():
                for leaf in jax.tree.leaves(call(array)):
                    assert leaf.dtype == given, name
                    assert isinstance(leaf, jax.Array) == (library is jnp), name
            for name, (dtype, call) in FIXED.items():
                assert call(array).dtype == dtype, name

        jax.eval_shape(check)  # traced, since compiling takes far longer
