"""A camera as one record: intrinsics, pose, image size and lens, changed together."""
# K is K.
# pyright: reportConstantRedefinition=false, reportUnknownVariableType=false

from dataclasses import dataclass, replace
from functools import partial
from types import ModuleType

import jax
import numpy as np

from jaxcam.errors import CameraError
from jaxcam.rays._arrays import Array, array_namespace, as_float, check_size, is_concrete, matmul
from jaxcam.rays._checks import LARGEST, check_camera
from jaxcam.rays._convert import opengl_from_opencv
from jaxcam.rays._plucker import Convention, rays
from jaxcam.rays.lens import Lens, check_distortion, distort, normalised, sight_lines, valid


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["K", "world_from_camera", "distortion"],
    meta_fields=["height", "width", "lens"],
)
@dataclass(frozen=True, eq=False)
class Camera:
    """A camera, or a batch of them that share an image size and a kind of lens.

    A pytree: `K`, `world_from_camera` and `distortion` are leaves, the rest is static. Methods
    return new cameras and keep NumPy under NumPy and JAX under JAX.

    Cropping, resizing and flipping change K alone: a lens acts on coordinates before K makes pixels
    of them, also in a mirrored image (`fx < 0`).

    Attributes:
        K: Intrinsics in pixels of the image, `[*batch, 3, 3]`; (0, 0) is the image's corner and
            (column + 0.5, row + 0.5) a pixel's centre. `fx < 0` means a mirrored image.
        world_from_camera: Pose `[*batch, 4, 4]`, OpenCV axes: x right, y down, z forward.
        height: Image rows.
        width: Image columns.
        distortion: Coefficients of the lens `[*batch, D]`; None is a pinhole. See
            `jaxcam.rays.lens`.
        lens: Which model they belong to.
    """

    K: Array
    world_from_camera: Array
    height: int
    width: int
    distortion: Array | None = None
    lens: Lens = "opencv"

    @classmethod
    def from_fovy(
        cls, fovy: Array, height: int, width: int, world_from_camera: Array | None = None
    ) -> "Camera":
        """Camera with square pixels and a centred principal point.

        Args:
            fovy: Vertical field of view in radians (MuJoCo's `cam_fovy` is in degrees), `[*batch]`.
            height: Image rows.
            width: Image columns.
            world_from_camera: Pose; the identity when left out.

        Raises:
            CameraError: If there is no such field of view.
        """
        xp = array_namespace(fovy)
        fovy = as_float(fovy, xp)
        if is_concrete(fovy) and not (np.asarray(fovy > 0) & np.asarray(fovy < np.pi)).all():
            raise CameraError(
                f"fovy must lie between 0 and pi radians, got {fovy}. Likely cause: degrees; "
                "see numpy.deg2rad."
            )
        f = 0.5 * height / xp.tan(0.5 * fovy)
        check_size("focal length in pixels", f, LARGEST)
        zero, one = xp.zeros_like(f), xp.ones_like(f)
        rows = (f, zero, 0.5 * width * one, zero, f, 0.5 * height * one, zero, zero, one)
        K = xp.stack(rows, axis=-1).reshape(*f.shape, 3, 3)
        if world_from_camera is None:
            world_from_camera = xp.broadcast_to(xp.eye(4, dtype=K.dtype), (*f.shape, 4, 4))
        return cls(K, world_from_camera, height, width)

    @property
    def batch(self) -> tuple[int, ...]:
        """Shape of the leading axes."""
        lens = () if self.distortion is None else np.shape(self.distortion)[:-1]
        pose = np.shape(self.world_from_camera)[:-2]
        return np.broadcast_shapes(np.shape(self.K)[:-2], pose, lens)

    @property
    def centre(self) -> Array:
        """Position of the camera in the world, `[*batch, 3]`."""
        return self.world_from_camera[..., :3, 3]

    @property
    def fovy(self) -> Array:
        """Vertical field of view in radians, for a principal point in the middle row."""
        xp = array_namespace(self.K)
        return 2 * xp.arctan(0.5 * self.height / self.K[..., 1, 1])

    def project(self, points: Array) -> tuple[Array, Array]:
        """Pixels and depths of world points.

        Args:
            points: `[*batch, ..., 3]`: the camera's batch axes (or ones), then any others.

        Returns:
            Pixel coordinates (u, v) `[*batch, ..., 2]` and planar depth `[*batch, ...]`, which is
            not positive for points behind the camera and for those outside the field of its lens;
            their (u, v) mean nothing.

        Raises:
            CameraError: If axes do not fit, or numbers are too large to compute with.
        """
        self._check_numbers(points=points)
        xp = array_namespace(self.K, self.world_from_camera, self.distortion, points)
        points = as_float(points, xp)
        K, pose, distortion = self._spread(xp, points.ndim - 1)
        p = matmul((points - pose[..., :3, 3])[..., None, :], pose[..., :3, :3])[..., 0, :]
        depth = p[..., 2]
        # Nearer to the plane of the camera than a nanometre there is nothing to see.
        near = xp.where(depth < 0, -1e-9, 1e-9).astype(depth.dtype)
        z = xp.where(xp.abs(depth) < 1e-9, near, depth)
        y = p[..., 1] / z
        x = p[..., 0] / z
        if distortion is not None:
            x, y, inside = distort(x, y, distortion, self.lens)
            depth = xp.where(inside, depth, -xp.abs(depth))
        u = K[..., 0, 0] * x + K[..., 0, 1] * y + K[..., 0, 2]
        v = K[..., 1, 1] * y + K[..., 1, 2]
        return xp.stack(xp.broadcast_arrays(u, v), axis=-1), depth

    def unproject(self, depth: Array, pixels: Array = None) -> Array:
        """World points seen at given depths.

        Args:
            depth: Planar depth, the z coordinate in camera axes (as MuJoCo's renderer gives it, not
                the length of the ray): `[*batch, height, width]`, or `[*batch, ...]` with `pixels`.
            pixels: Pixel coordinates (u, v), `[*batch, ..., 2]`; all pixels' centres if left out.

        Returns:
            Points `[*batch, ..., 3]`; the camera's own centre for pixels that are outside the field
            of its lens.

        Raises:
            CameraError: If shapes do not fit, or numbers are too large to compute with.
        """
        self._check_numbers(depth=depth, pixels=pixels)
        xp = array_namespace(self.K, self.world_from_camera, self.distortion, depth, pixels)
        depth = as_float(depth, xp)
        if pixels is None:
            if depth.shape[-2:] != (self.height, self.width):
                raise CameraError(
                    f"depth has shape {list(depth.shape)}, expected [..., {self.height}, "
                    f"{self.width}]. Likely cause: K belongs to another resolution."
                )
            pixels = self.pixel_centres()
        pixels = as_float(pixels, xp)
        K, pose, distortion = self._spread(xp, max(depth.ndim, pixels.ndim - 1))
        x, y = normalised(K, pixels[..., 0], pixels[..., 1])
        if distortion is not None:
            x, y, z = sight_lines(x, y, distortion, self.lens)
            in_front = z > 0
            x, y = (xp.where(in_front, a / xp.where(in_front, z, 1), 0) for a in (x, y))
            depth = xp.where(in_front, depth, 0)
        p = xp.stack(xp.broadcast_arrays(x * depth, y * depth, depth), axis=-1)
        return matmul(pose[..., :3, :3], p[..., None])[..., 0] + pose[..., :3, 3]

    def pixel_centres(self) -> np.ndarray:
        """Coordinates (u, v) of all pixels' centres, float32 `[height, width, 2]`."""
        u, v = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return np.stack([u, v], axis=-1).astype(np.float32)

    def crop(self, top: Array, left: Array, height: int, width: int) -> "Camera":
        """The camera of `image[top : top + height, left : left + width]`.

        Args:
            top: First row, a number or `[*batch]`; may be traced.
            left: First column, likewise.
            height: Rows of the crop.
            width: Columns of the crop.
        """
        xp = array_namespace(self.K, top, left)
        top, left = as_float(top, xp), as_float(left, xp)
        zero = xp.zeros_like(top + left)
        shift = xp.stack([left + zero, top + zero, zero], axis=-1)
        K = as_float(self.K, xp)
        moved = K - (shift[..., :, None] * np.array([0, 0, 1.0], np.float32)).astype(K.dtype)
        return replace(self, K=moved, height=height, width=width)

    def resize(self, height: int, width: int) -> "Camera":
        """The camera of the image resized to `height` x `width`."""
        scale = [width / self.width, height / self.height, 1.0]
        return replace(self, K=self._scale_rows(scale), height=height, width=width)

    def flip_horizontal(self) -> "Camera":
        """The camera of the mirrored image `image[:, ::-1]`.

        The pose stays a rotation and the flip goes into the intrinsics: `fx` changes its sign and
        `cx` becomes `width - cx`. Each pixel keeps the ray it had, so the ray-map of the flipped
        camera is the flipped ray-map. (A pose mirrored instead would describe another world.)
        """
        xp = array_namespace(self.K)
        K = self._scale_rows([-1.0, 1.0, 1.0])
        offset = np.array([[0, 0, self.width], [0, 0, 0], [0, 0, 0]])
        return replace(self, K=K + xp.asarray(offset, K.dtype))

    def in_frame(self, new_from_world: Array) -> "Camera":
        """The same camera with its pose expressed in another frame.

        Args:
            new_from_world: Rigid transform `[*batch, 4, 4]`, for example `base_from_world`.
        """
        xp = array_namespace(new_from_world, self.world_from_camera)
        new, old = as_float(new_from_world, xp), as_float(self.world_from_camera, xp)
        return replace(self, world_from_camera=matmul(new, old))

    def plucker(self, *, convention: Convention = "jaxcam") -> jax.Array:
        """Ray-map, float32 `[*batch, height, width, 6]`; see `jaxcam.rays.plucker`.

        The pose is in OpenCV axes also for `convention="authors"`. A principal point outside the
        image is accepted here, since a crop of a corner has one.
        """
        self._check("camera", off_axis=True)
        authors = convention == "authors"
        pose = opengl_from_opencv(self.world_from_camera) if authors else self.world_from_camera
        size = int(self.height), int(self.width)
        ray_map: Array = rays(self.K, pose, *size, convention, self.distortion, self.lens)
        return ray_map

    def has_ray(self) -> Array:
        """Which pixels have a ray, bool `[*batch, height, width]`: all of a pinhole's do."""
        if self.distortion is None:
            return np.ones((*self.batch, self.height, self.width), bool)
        has_ray = valid(self.K, self.height, self.width, self.distortion, lens=self.lens)
        shape = (*self.batch, self.height, self.width)
        return array_namespace(has_ray).broadcast_to(has_ray, shape)

    def validate(self, name: str = "camera") -> "Camera":
        """Check all parameters where they are concrete; call it where cameras are read.

        Args:
            name: What to call the camera in the message.

        Returns:
            The camera itself.

        Raises:
            CameraError: Naming the camera, the check, expected and got, and the likely cause.
        """
        self._check(name, off_axis=False)
        return self

    def _check(self, name: str, *, off_axis: bool) -> None:
        check_camera(
            self.K, self.world_from_camera, self.height, self.width, name=name, off_axis=off_axis
        )
        if self.distortion is not None:
            check_distortion(self.distortion, self.lens, name)

    def _check_numbers(self, **arrays: Array) -> None:
        """Raise `CameraError` for numbers that give infinity; others are `validate`'s."""
        check_size("K", self.K, LARGEST)
        check_size("world_from_camera", self.world_from_camera, LARGEST)
        if self.distortion is not None:
            check_distortion(self.distortion, self.lens)
        for what, values in arrays.items():
            if values is not None:
                # So large that what it is divided by and multiplied with still fits float32.
                check_size(what, values, 1e18)

    def _scale_rows(self, scale: list[float]) -> Array:
        xp = array_namespace(self.K)
        K = as_float(self.K, xp)
        return K * xp.asarray(scale, K.dtype)[:, None]

    def _spread(self, xp: ModuleType, ndim: int) -> tuple[Array, Array, Array | None]:
        """K, pose and lens with axes of one after the batch axes, `ndim` leading axes in all."""
        extra = ndim - len(self.batch)
        if extra < 0:
            raise CameraError(
                f"expected an array that starts with the camera's batch axes {self.batch}, got "
                f"one with {ndim} leading axes. Add axes of length 1 where the cameras share it."
            )
        K = as_float(self.K, xp)
        pose = as_float(self.world_from_camera, xp)
        ones = (1,) * extra
        lens = None
        if self.distortion is not None:
            lens = as_float(self.distortion, xp)
            lens = lens.reshape(*lens.shape[:-1], *ones, lens.shape[-1])
        return (
            K.reshape(*K.shape[:-2], *ones, 3, 3),
            pose.reshape(*pose.shape[:-2], *ones, 4, 4),
            lens,
        )
