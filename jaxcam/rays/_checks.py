"""Checks of camera parameters, with messages that name the camera and the likely mistake."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from jaxcam.errors import CameraError
from jaxcam.rays._arrays import Array, is_concrete

ROTATION_TOLERANCE = 1e-3
"""Largest accepted entry of |RᵀR - I|."""

LARGEST = 1e6
"""Largest accepted number of a camera (metres, pixels): float32 has seven digits."""

_BOTTOM = np.array([0.0, 0.0, 0.0, 1.0])
_EYE = np.eye(3)


def _missing(_: np.ndarray) -> str:
    return "a failed calibration or a missing camera"


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
    causes: dict[tuple[int, ...], str] = {
        (3, 4): "a 3x4 matrix without its last row 0 0 0 1; append it",
        (3, 3): "a rotation without its position",
        (4,): "K given as a list (fx, fy, cx, cy); build the matrix",
        (16,): "a flattened matrix; reshape it to 4x4",
        (9,): "a flattened matrix; reshape it to 3x3",
        (4, 4): "a 4x4 projection matrix, or the two arguments swapped",
    }
    cause = causes.get(tuple(shape[-2:]), "another array passed in its place")
    raise CameraError(
        f"{name}: {what} has the wrong shape. Expected [..., {rows}, {columns}], got "
        f"{list(shape)}. Likely cause: {cause}."
    )


def _check_size(name: str, height: object, width: object) -> None:
    for what, value in (("height", height), ("width", width)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value <= 0:
            raise CameraError(
                f"{name}: image {what} must be a positive whole number of pixels, known when "
                f"tracing; got {value!r}."
            )
        if value > LARGEST:
            raise CameraError(
                f"{name}: image {what}: expected up to {LARGEST:g} pixels, got {value}."
            )


def _check_intrinsics(name: str, K: np.ndarray, height: int, width: int, off_axis: bool) -> None:
    check = _Check(name, K)
    check(
        np.isfinite(K).all((-2, -1)),
        "values of K",
        expected="finite numbers",
        got=_show,
        cause=_missing,
    )
    check(
        (np.abs(K) <= LARGEST).all((-2, -1)),
        "size of the numbers of K",
        expected=f"up to {LARGEST:g} pixels",
        got=_show,
        cause=lambda _: "uninitialised memory, or K in another unit than pixels",
    )
    fx, fy = K[..., 0, 0], K[..., 1, 1]
    # fx < 0 with fy > 0 is a mirrored image, as Camera.flip_horizontal makes.
    check(
        (fx != 0) & (fy > 0),
        "focal lengths",
        expected="fx != 0 and fy > 0",
        got=_focal_lengths,
        cause=lambda k: (
            "K from an OpenGL projection, whose y axis points up; jaxcam's points down"
            if k[1, 1] < 0
            else "K was never filled in"
        ),
    )
    check(
        (K[..., 2, :] == _BOTTOM[1:]).all(-1) & (K[..., 1, 0] == 0),
        "form of K",
        expected="[[fx, s, cx], [0, fy, cy], [0, 0, 1]]",
        got=_show,
        cause=lambda k: "K is transposed" if k[2, 0] and not k[0, 2] else "not an intrinsic matrix",
    )
    cx, cy = K[..., 0, 2], K[..., 1, 2]
    check(
        off_axis | ((cx >= 0) & (cx <= width) & (cy >= 0) & (cy <= height)),
        "principal point",
        expected=f"inside the image, 0 <= cx <= {width} and 0 <= cy <= {height}",
        got=lambda k: f"({k[0, 2]:g}, {k[1, 2]:g})",
        cause=lambda _: (
            "K belongs to another resolution (see Camera.resize), or height and width are swapped"
        ),
    )
    check(
        (np.abs(fx) > 0.05 * width) & (fy > 0.05 * height),
        "unit of the focal lengths",
        expected=f"pixels of a {width}x{height} image",
        got=_focal_lengths,
        cause=lambda _: "K is in normalised units or in millimetres",
    )


def check_pose(name: str, pose: np.ndarray) -> None:
    """Raise `CameraError` for the first pose of a batch that cannot be.

    Args:
        name: What to call the pose in the message; an index is added for a batch.
        pose: `[..., 4, 4]`, any camera axes, positions in metres.
    """
    check_shape(name, "world_from_camera", pose, (4, 4))
    check = _Check(name, pose)
    check(
        np.isfinite(pose).all((-2, -1)),
        "values of world_from_camera",
        expected="finite numbers",
        got=_show,
        cause=_missing,
    )
    check(
        (np.abs(pose[..., 3, :] - _BOTTOM) < 1e-6).all(-1),
        "last row of world_from_camera",
        expected="[0, 0, 0, 1]",
        got=lambda p: _show(p[3]),
        cause=lambda p: (
            "the matrix is transposed" if (p[:, 3] == _BOTTOM).all() else "not a rigid transform"
        ),
    )
    check(
        (np.abs(pose[..., :3, 3]) <= LARGEST).all(-1),
        "position of world_from_camera",
        expected=f"up to {LARGEST:g} metres from the origin",
        got=lambda p: _show(p[:3, 3]),
        cause=lambda _: (
            "uninitialised memory, or coordinates on the earth; express the pose in the robot base"
        ),
    )
    rotation = pose[..., :3, :3].astype(np.float64)
    gram = np.swapaxes(rotation, -1, -2) @ rotation
    check(
        (np.abs(gram - _EYE) <= ROTATION_TOLERANCE).all((-2, -1)),
        "rotation R of world_from_camera",
        expected=f"|RᵀR - I| <= {ROTATION_TOLERANCE:g}",
        got=lambda p: f"{_rotation_error(p):.3g} with R = {_show(p[:3, :3])}",
        cause=lambda p: (
            "the matrix holds a scale"
            if np.ptp(_column_lengths(p)) < 1e-3
            else "rounded numbers, averaged matrices, or a quaternion that was not normalised"
        ),
    )
    check(
        np.linalg.det(rotation) > 0,
        "determinant of the rotation of world_from_camera",
        expected="+1",
        got=lambda p: f"{np.linalg.det(p[:3, :3]):.3f}",
        cause=lambda _: (
            "a mirrored basis: one axis was negated instead of two (OpenGL to OpenCV negates y "
            "and z), or two axes were swapped"
        ),
    )


class _Check:
    """Raises for the first camera of a batch that fails; texts are made only then."""

    def __init__(self, name: str, values: np.ndarray) -> None:
        self.name, self.values = name, values

    def __call__(
        self,
        ok: Array,
        check: str,
        *,
        expected: str,
        got: Callable[[np.ndarray], str],
        cause: Callable[[np.ndarray], str],
    ) -> None:
        if np.all(ok):
            return
        ok = np.broadcast_to(ok, self.values.shape[:-2])
        bad = np.argwhere(~ok)
        index = tuple(bad[0].tolist())
        value = self.values[index].astype(np.float64)
        where = f"{self.name}[{', '.join(map(str, index))}]" if index else self.name
        others = f" {len(bad)} of {ok.size} cameras fail this check." if ok.size > 1 else ""
        raise CameraError(
            f"{where}: {check}: expected {expected}, got {got(value)}. "
            f"Likely cause: {cause(value)}.{others}"
        )


def _focal_lengths(K: np.ndarray) -> str:
    return f"fx {K[0, 0]:g}, fy {K[1, 1]:g}"


def _column_lengths(pose: np.ndarray) -> np.ndarray:
    return np.linalg.norm(pose[:3, :3], axis=0)


def _rotation_error(pose: np.ndarray) -> float:
    R = pose[:3, :3]
    return float(np.abs(R.T @ R - _EYE).max())


def _show(a: np.ndarray) -> str:
    return np.array2string(a, precision=4, separator=", ", suppress_small=True).replace("\n", "")
