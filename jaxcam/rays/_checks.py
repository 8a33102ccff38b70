"""Checks of camera parameters, with messages that name the camera and the likely mistake."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from jaxcam.errors import CameraError
from jaxcam.rays._arrays import Array, is_concrete

ROTATION_TOLERANCE = 1e-3
"""Largest accepted entry of |RᵀR - I|."""


def check_camera(
    K: Array,
    world_from_camera: Array,
    height: int,
    width: int,
    *,
    name: str = "camera",
    off_axis: bool = False,
) -> None:
    """Raise `CameraError` for the first camera that cannot exist.

    Shapes are always checked, values only where they are concrete: inside `jit` nothing is added
    to the program.

    Args:
        K: Intrinsics `[..., 3, 3]`.
        world_from_camera: Pose `[..., 4, 4]`.
        height: Image rows.
        width: Image columns.
        name: What to call the camera in the message; an index is added for a batch.
        off_axis: Accept a principal point outside the image, as a crop of a corner has.
    """
    check_shape(name, "K", K, (3, 3))
    check_shape(name, "world_from_camera", world_from_camera, (4, 4))
    _check_size(name, height, width)
    try:
        np.broadcast_shapes(np.shape(K)[:-2], np.shape(world_from_camera)[:-2])
    except ValueError:
        raise CameraError(
            f"{name}: batch axes of K {np.shape(K)[:-2]} and world_from_camera "
            f"{np.shape(world_from_camera)[:-2]} do not broadcast."
        ) from None
    if is_concrete(K):
        _check_intrinsics(name, np.asarray(K), int(height), int(width), off_axis)
    if is_concrete(world_from_camera):
        check_pose(name, np.asarray(world_from_camera))


def check_shape(name: str, what: str, value: Array, expected: tuple[int, int]) -> None:
    """Raise `CameraError` unless `value` is `[..., *expected]`."""
    try:
        array = value if isinstance(value, jax.Array) else np.asarray(value)
    except ValueError:
        raise CameraError(f"{name}: {what} must be an array of numbers, got {value!r}.") from None
    shape, dtype = array.shape, array.dtype
    if not (jnp.issubdtype(dtype, jnp.floating) or jnp.issubdtype(dtype, jnp.integer)):
        raise CameraError(f"{name}: {what} must hold real numbers, got dtype {dtype}.")
    if shape[-2:] == expected:
        return
    rows, columns = expected
    cause = {
        (3, 4): "a 3x4 matrix without its last row 0 0 0 1; append it",
        (3, 3): "a rotation without its position",
        (4,): "K given as a list (fx, fy, cx, cy); build the matrix",
        (16,): "a flattened matrix; reshape it to 4x4",
        (9,): "a flattened matrix; reshape it to 3x3",
        (4, 4): "a 4x4 projection matrix, or the two arguments swapped",
    }.get(shape[-2:], "another array passed in its place")
    raise CameraError(
        f"{name}: {what} has the wrong shape. Expected [..., {rows}, {columns}], got "
        f"{list(shape)}. Likely cause: {cause}."
    )


def _check_size(name: str, height: int, width: int) -> None:
    for what, value in (("height", height), ("width", width)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value <= 0:
            raise CameraError(
                f"{name}: image {what} must be a positive whole number of pixels, known when "
                f"tracing; got {value!r}."
            )


def _check_intrinsics(name: str, K: np.ndarray, height: int, width: int, off_axis: bool) -> None:
    def require(ok: np.ndarray, check: str, describe: Callable[[np.ndarray], str]) -> None:
        _require(name, ok, K, check, describe)

    require(
        np.isfinite(K).all((-2, -1)),
        "K must be finite",
        lambda k: f"got {_show(k)}. Likely cause: a failed calibration or a missing camera.",
    )
    fx, fy = K[..., 0, 0], K[..., 1, 1]
    # fx < 0 with fy > 0 is a mirrored image, as Camera.flip_horizontal makes.
    require(
        (fx != 0) & (fy > 0),
        "focal lengths must not be zero, nor fy negative",
        lambda k: (
            f"got fx {k[0, 0]:g}, fy {k[1, 1]:g}. Likely cause: "
            + (
                "K from an OpenGL projection, whose y axis points up; jaxcam's points down."
                if k[1, 1] < 0
                else "K was never filled in."
            )
        ),
    )
    bottom = np.abs(K[..., 2, :] - (0, 0, 1)).max(-1)
    require(
        (bottom < 1e-6) & (np.abs(K[..., 1, 0]) < 1e-6 * fy),
        "K must be upper triangular with last row 0 0 1",
        lambda k: (
            f"got {_show(k)}. Likely cause: "
            + ("K is transposed." if k[2, 0] and not k[0, 2] else "not an intrinsic matrix.")
        ),
    )
    cx, cy = K[..., 0, 2], K[..., 1, 2]
    require(
        off_axis | ((cx >= 0) & (cx <= width) & (cy >= 0) & (cy <= height)),
        "the principal point must lie in the image",
        lambda k: (
            f"expected 0 <= cx <= {width} and 0 <= cy <= {height}, got ({k[0, 2]:g}, {k[1, 2]:g}). "
            "Likely cause: K belongs to another resolution (see Camera.resize), or is in normalised"
            " units, or height and width are swapped."
        ),
    )
    require(
        (np.abs(fx) > 0.05 * width) & (fy > 0.05 * height),
        "focal lengths must be in pixels",
        lambda k: (
            f"got fx {k[0, 0]:g}, fy {k[1, 1]:g} for a {width}x{height} image. Likely cause: K is "
            "in normalised units or millimetres."
        ),
    )


def check_pose(name: str, pose: np.ndarray) -> None:
    """Raise `CameraError` for the first of `[..., 4, 4]` that is not a rigid transform."""
    check_shape(name, "world_from_camera", pose, (4, 4))

    def require(ok: np.ndarray, check: str, describe: Callable[[np.ndarray], str]) -> None:
        _require(name, ok, pose, check, describe)

    require(
        np.isfinite(pose).all((-2, -1)),
        "world_from_camera must be finite",
        lambda p: f"got {_show(p)}. Likely cause: a failed calibration or a missing camera.",
    )
    require(
        np.abs(pose[..., 3, :] - (0, 0, 0, 1)).max(-1) < 1e-6,
        "the last row of world_from_camera must be 0 0 0 1",
        lambda p: (
            f"got {_show(p[3])}. Likely cause: "
            + (
                "the matrix is transposed."
                if np.allclose(p[:, 3], (0, 0, 0, 1))
                else "not a rigid transform."
            )
        ),
    )
    rotation = pose[..., :3, :3].astype(np.float64)
    gram = np.swapaxes(rotation, -1, -2) @ rotation
    require(
        np.abs(gram - np.eye(3)).max((-2, -1)) <= ROTATION_TOLERANCE,
        "the rotation of world_from_camera must be orthonormal",
        lambda p: _describe_rotation(p[:3, :3]),
    )
    require(
        np.linalg.det(rotation) > 0,
        "the rotation of world_from_camera must have determinant +1",
        lambda p: (
            f"got {np.linalg.det(p[:3, :3]):.3f}. Likely cause: a mirrored basis: one axis was "
            "negated instead of two (OpenGL to OpenCV negates y and z), or two axes were swapped."
        ),
    )


def _describe_rotation(R: np.ndarray) -> str:
    R = R.astype(np.float64)
    error = np.abs(R.T @ R - np.eye(3)).max()
    scale = np.linalg.norm(R, axis=0)
    if np.allclose(scale, scale[0], rtol=1e-3) and abs(scale[0] - 1) > 1e-4:
        cause = f"the matrix is scaled by {scale[0]:.4g}."
    else:
        cause = "rounded numbers, averaged matrices, or a quaternion that was not normalised."
    return (
        f"expected |RᵀR - I| <= {ROTATION_TOLERANCE:g}, got {error:.3g} with R = {_show(R)}. "
        f"Likely cause: {cause}"
    )


def _require(
    name: str,
    ok: np.ndarray,
    values: np.ndarray,
    check: str,
    describe: Callable[[np.ndarray], str],
) -> None:
    ok = np.broadcast_to(ok, values.shape[:-2])
    if ok.all():
        return
    bad = np.argwhere(~ok)
    index = tuple(int(i) for i in bad[0])
    where = f"{name}[{', '.join(map(str, index))}]" if index else name
    others = f" ({len(bad)} of {ok.size} cameras fail this check.)" if ok.size > 1 else ""
    raise CameraError(f"{where}: {check}; {describe(values[index])}{others}")


def _show(a: np.ndarray) -> str:
    return np.array2string(a, precision=4, separator=", ", suppress_small=True).replace("\n", "")
