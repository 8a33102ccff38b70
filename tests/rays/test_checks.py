"""Impossible cameras: refused by name, with the check, expected, got, and the likely cause."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rays_oracle import random_camera

from jaxcam import rays
from jaxcam.errors import CameraError
from jaxcam.rays import Camera, plucker

H, W = 64, 80
K0 = np.array([[70.0, 0, 40], [0, 70, 32], [0, 0, 1]])
X0 = random_camera(0).world_from_camera


def changed(matrix, index, value):
    matrix = matrix.copy()
    matrix[index] = value
    return matrix


ROTATION = (slice(0, 3), slice(0, 3))
BAD = {
    "K list": (np.array([70.0, 70, 40, 32]), X0, r"K has the wrong shape.*\[4\].*list"),
    "K 4x4": (np.eye(4), X0, r"Expected \[\.\.\., 3, 3\], got \[4, 4\].*projection"),
    "K flat": (K0.ravel(), X0, r"flattened"),
    "pose 3x4": (K0, X0[:3], r"world_from_camera has the wrong shape.*append it"),
    "rotation only": (K0, X0[:3, :3], r"without its position"),
    "K ragged": ([[1, 2], [3]], X0, r"K must be an array of numbers"),
    "K complex": (K0 * 1j, X0, r"real numbers, got dtype complex128"),
    "K nan": (changed(K0, (0, 2), np.nan), X0, r"values of K: expected finite.*nan"),
    "K beyond float32": (changed(K0, (0, 0), 1e39), X0, r"size of the numbers of K.*1e\+06"),
    "cx beyond float32": (changed(K0, (0, 2), -1e39), X0, r"size of the numbers of K"),
    "pose beyond float32": (
        K0,
        changed(X0, (1, 3), 1e39),
        r"position of world_from_camera.*metres",
    ),
    "pose on the earth": (K0, changed(X0, (1, 3), 5.4e6), r"position.*robot base"),
    "pose inf": (K0, changed(X0, (1, 3), np.inf), r"values of world_from_camera.*inf"),
    "fx zero": (changed(K0, (0, 0), 0), X0, r"focal lengths: expected fx != 0.*got fx 0"),
    "fy zero": (changed(K0, (1, 1), 0), X0, r"got fx 70, fy 0.*never filled"),
    "fy negative": (changed(K0, (1, 1), -70), X0, r"fy -70.*OpenGL"),
    "K transposed": (K0.T, X0, r"form of K.*transposed"),
    "K last row": (changed(K0, (2, 2), 2), X0, r"form of K.*not an intrinsic"),
    "other size": (K0 * [[4], [4], [1]], X0, r"principal point.*got \(160, 128\).*resolution"),
    "normalised": (
        np.array([[0.9, 0, 0.5], [0, 0.9, 0.5], [0, 0, 1]]),
        X0,
        r"expected pixels.*normalised",
    ),
    "pose transposed": (K0, X0.T, r"last row.*expected \[0, 0, 0, 1\].*transposed"),
    "pose last row": (K0, changed(X0, (3, 3), 2), r"last row.*not a rigid"),
    "scaled": (K0, changed(X0, ROTATION, 1.01 * X0[ROTATION]), r"rotation R.*<= 0.001.*scale"),
    "sheared": (K0, changed(X0, (0, 1), X0[0, 1] + 0.02), r"rotation R.*averaged"),
    "mirrored": (K0, X0 @ np.diag([1, -1, 1, 1]), r"determinant.*\+1, got -1.*negates y and z"),
}


@pytest.mark.parametrize("case", BAD)
def test_each_impossible_camera_is_refused(case):
    K, pose, message = BAD[case]
    with pytest.raises(CameraError, match=message):
        plucker(K, pose, H, W)


@pytest.mark.parametrize(
    "case", [case for case, (K, *_) in BAD.items() if isinstance(K, np.ndarray)]
)
def test_records_are_checked_by_name(case):
    K, pose, message = BAD[case]
    with pytest.raises(CameraError, match=f"^demo_3/agentview: .*{message}"):
        Camera(np.asarray(K), pose, H, W).validate(name="demo_3/agentview")


@pytest.mark.parametrize("size", [(0, 80), (64, -1), (64.0, 80), (True, 80), ("64", 80)])
def test_impossible_sizes(size):
    with pytest.raises(CameraError, match=r"image (height|width) must be a positive whole number"):
        plucker(K0, X0, *size)


def test_a_batch_names_the_camera_and_counts():
    K = np.tile(K0, (2, 3, 1, 1))
    K[1, 0, 0, 0] = 0
    K[1, 2, 0, 0] = 0
    with pytest.raises(CameraError, match=r"^camera\[1, 0\]: focal lengths: .* 2 of 6 cameras"):
        plucker(K, X0, H, W)


def test_batch_axes_that_do_not_broadcast():
    with pytest.raises(CameraError, match=r"\(2,\) and world_from_camera \(3,\) do not broadcast"):
        plucker(np.tile(K0, (2, 1, 1)), np.tile(X0, (3, 1, 1)), H, W)


def test_good_cameras_pass():
    rounded = X0.copy()
    rounded[:3, :3] = np.round(X0[:3, :3], 4)
    plucker(K0, rounded, H, W)
    plucker(jnp.asarray(K0), jnp.asarray(X0), H, W)
    plucker(K0, np.eye(4, dtype=int), H, W)
    assert Camera(K0, X0, H, W).validate().height == H


def test_mirrored_image_is_a_camera_but_a_mirrored_pose_is_not():
    flipped = Camera(K0, X0, H, W).flip_horizontal()
    assert flipped.validate().K[0, 0] < 0
    plucker(flipped.K, X0, H, W)
    with pytest.raises(CameraError, match="determinant"):
        plucker(K0, X0 @ np.diag([-1, 1, 1, 1]), H, W)


def test_corner_crop_has_rays_but_does_not_pass_for_a_whole_image():
    crop = Camera(K0, X0, H, W).crop(40, 50, 20, 20)
    assert crop.plucker().shape == (20, 20, 6)
    with pytest.raises(CameraError, match="principal point"):
        crop.validate()


def test_inside_jit_shapes_are_checked_and_values_are_not():
    bad = jnp.asarray(X0 @ np.diag([1, -1, 1, 1]))
    jax.jit(lambda x: plucker(K0, x, H, W))(bad)
    with pytest.raises(CameraError, match="wrong shape"):
        jax.jit(lambda x: plucker(K0, x, H, W))(bad[:3])
    with pytest.raises(CameraError, match="focal lengths"):
        # A constant of the traced function is still a concrete array.
        jax.jit(lambda x: plucker(np.zeros((3, 3)), x, H, W))(bad)
    with pytest.raises(CameraError, match="known when tracing"):
        jax.jit(lambda h: plucker(K0, X0, h, W))(3)


@pytest.mark.parametrize("library", [np.asarray, jnp.asarray])
@pytest.mark.parametrize("size", [1e19, 1e39, 1e300])
def test_numbers_too_large_are_refused_by_whatever_takes_them(size, library):
    """Checked in float64 and computed in float32, they gave infinity or NaN in silence."""
    camera = Camera(library(K0), library(X0), H, W)
    huge = np.array([size, 1.0, 1.0])
    calls = {
        "project": lambda: camera.project(huge),
        "depth": lambda: camera.unproject(np.full((H, W), size)),
        "pixels": lambda: camera.unproject(np.array(1.0), huge[:2]),
        "K of project": lambda: Camera(K0 * [[size], [1], [1]], library(X0), H, W).project(
            [0, 0, 1]
        ),
        "pose": lambda: camera.in_frame(changed(np.eye(4), (0, 3), size)).plucker(),
        "crop": lambda: camera.crop(size, 0, 8, 8).plucker(),
        "resize": lambda: camera.resize(8, 10**19).plucker(),
        "fovy": lambda: Camera.from_fovy(library(1e-30), H, W),
        "spherical": lambda: rays.spherical(changed(X0, (0, 3), size), np.zeros(3)),
        "centre": lambda: rays.spherical(library(X0), huge),
        "look_at": lambda: rays.look_at(huge, library(np.zeros(3))),
        "target": lambda: rays.look_at(library(np.zeros(3)), huge),
        "perturb": lambda: rays.perturb(changed(X0, (0, 3), size), jax.random.key(0)),
        "far": lambda: rays.perturb(X0, jax.random.key(0), 0.1, size),
        "lens": lambda: plucker(K0, X0, H, W, distortion=[size, 0, 0, 0]),
        "height": lambda: plucker(K0, X0, 10**7, W),
    }
    for name, call in calls.items():
        with pytest.raises(CameraError):
            pytest.fail(f"{name} gave {call()}")


@pytest.mark.parametrize("library", [np.asarray, jnp.asarray])
def test_what_is_accepted_gives_finite_numbers(library):
    far = changed(X0, (slice(0, 3), 3), 1e6)
    camera = Camera(library(changed(K0, (0, 0), 1e6)), library(far), H, W)
    assert np.isfinite(camera.plucker()).all()
    for point in (far[:3, 3], [1e18, -1e18, 1e18], far[:3, 3] + far[:3, 0]):
        assert np.isfinite(camera.project(library(np.array(point)))[0]).all()
    assert np.isfinite(camera.unproject(library(np.full((H, W), 1e18)))).all()
