"""K and the lens of a camera from the corners of a flat board, with their uncertainty.

Focal lengths are tried first; then all unknowns (K, the lens, the board's pose in each picture) are
fitted to the corners' pixels, whose derivatives OpenCV gives. How sure a ray is follows from the
unknowns' covariance, for each pixel.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from jaxcam.config.calibrate import LensKind
from jaxcam.errors import DatasetError
from jaxcam.interop.cameras.optics import Optics
from jaxcam.rays import lens
from jaxcam.robot.calibration.boards import BoardSeen
from jaxcam.robot.calibration.fitting import Fitted, fit_pixels
from jaxcam.robot.calibration.projection import HALF

FOCAL = np.geomspace(0.25, 4.0, 25)
"""Focal lengths that are tried first, in widths of the picture."""
PRIORS = {
    "opencv": (0.5, 0.5, 0.01, 0.01, 0.5, 0.5, 0.5, 0.5),
    "fisheye": (0.3, 0.3, 0.3, 0.3),
}
"""What coefficients of real lenses are of the order of: keeps those that hardly matter small."""
SHIFT = 0.1
"""How far the centre may be from the middle of the picture, in its widths."""
GRID = (13, 17)
"""Rows and columns of the pixels whose rays are judged."""


@dataclass(frozen=True)
class LensFit:
    """What a camera's pictures of a board say of it."""

    optics: Optics
    """K and lens; its pixels are ours."""
    kind: LensKind
    coefficients: np.ndarray
    """Of the lens, in OpenCV's order."""
    sigmas: np.ndarray
    """Standard deviations of fx, fy, cx and cy (pixels), then of the coefficients."""
    boards: np.ndarray = field(repr=False)
    """Poses of the board in the camera's axes, [pictures, 4, 4]."""
    views: tuple[BoardSeen, ...] = field(repr=False)
    """The corners of each picture."""
    residuals: tuple[np.ndarray, ...] = field(repr=False)
    """Of each picture's corners, pixels [n, 2]: the fit less what was seen."""
    used: tuple[np.ndarray, ...] = field(repr=False)
    """Which corners count, bool [n] each."""
    rms: float
    """Root mean square of the corners' distances (pixels)."""
    rays: np.ndarray = field(repr=False)
    """Standard deviation of rays over the picture (pixels) at `ray_pixels`; `GRID`."""


def ray_pixels(width: int, height: int) -> np.ndarray:
    """The pixels whose rays are judged, corners of the picture included, [*GRID, 2]."""
    u, v = np.meshgrid(np.linspace(0, width, GRID[1]), np.linspace(0, height, GRID[0]))
    return np.stack([u, v], -1)


def fit_lens(
    points: np.ndarray,
    views: Sequence[BoardSeen],
    size: tuple[int, int],
    kind: LensKind = "opencv",
    coefficients: int = 5,
) -> LensFit:
    """Finds K and the lens.

    Args:
        points: Corners of the board in its own axes, [n, 3] (m), all z zero.
        views: Which of them each picture shows, and where.
        size: Width and height of the pictures.
        kind: Model of the lens.
        coefficients: How many it has.

    Raises:
        DatasetError: No camera sees a flat board like that.
    """
    model = _Model(points, tuple(views), size, kind, coefficients)
    start = _start(model)
    fitted = fit_pixels(
        model.residuals, start, jacobian=model.slopes, prior=model.prior(start)
    )  # fmt: skip
    return _result(model, fitted)


def residuals_at_best(points: np.ndarray, pixels: np.ndarray, fit: LensFit) -> np.ndarray:
    """What a lens leaves of another picture's corners, at the board's best pose there.

    Args:
        points: Of the board, [n, 3] (m).
        pixels: Where they were seen, [n, 2], ours.
        fit: The lens.

    Returns:
        Pixels [n, 2]; very large where the board has no such pose.
    """
    K = fit.optics.K
    own = np.array([K[0, 0], K[1, 1], K[0, 2] - HALF, K[1, 2] - HALF, *fit.coefficients])
    start = _pose(points, pixels - HALF, own, fit.kind)
    if start is None:
        return np.full(pixels.shape, 1e3)
    return fit_pixels(
        lambda pose: project_board(points, pose, own, fit.kind)[0] - (pixels - HALF),
        start,
        jacobian=lambda pose: project_board(points, pose, own, fit.kind)[2],
    ).residuals


@dataclass(frozen=True)
class _Model:
    """The unknowns: fx, fy, cx, cy, the coefficients, and six numbers of a pose a picture."""

    points: np.ndarray
    views: tuple[BoardSeen, ...]
    size: tuple[int, int]
    kind: LensKind
    count: int

    @property
    def own(self) -> int:
        """Unknowns of the camera itself."""
        return 4 + self.count

    def prior(self, start: np.ndarray) -> np.ndarray:
        """Standard deviations of the unknowns before any picture; see `fit_pixels`."""
        prior = np.full(len(start), np.inf)
        prior[2:4] = SHIFT * self.size[0]
        prior[4 : self.own] = PRIORS[self.kind][: self.count]
        return prior

    def residuals(self, x: np.ndarray) -> np.ndarray:
        return np.concatenate([
            self.project(x, i)[0] - (view.pixels - HALF) for i, view in enumerate(self.views)
        ])  # fmt: skip

    def slopes(self, x: np.ndarray) -> np.ndarray:
        parts = []
        for i in range(len(self.views)):
            camera, pose = self.project(x, i)[1:]
            part = np.zeros((*camera.shape[:2], len(x)))
            part[..., : self.own] = camera
            part[..., self.own + 6 * i : self.own + 6 * i + 6] = pose
            parts.append(part)
        return np.concatenate(parts)

    def project(self, x: np.ndarray, i: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """OpenCV's pixels of a picture's corners, and their derivatives by camera and pose."""
        pose = x[self.own + 6 * i : self.own + 6 * i + 6]
        return project_board(self.points[self.views[i].ids], pose, x[: self.own], self.kind)


def project_board(
    points: np.ndarray, pose: np.ndarray, own: np.ndarray, kind: LensKind
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """OpenCV's pixels of points, with derivatives.

    Args:
        points: Array [n, 3] (m).
        pose: Rotation vector and translation of the points' frame in the camera's axes, [6].
        own: Numbers fx, fy, cx, cy as OpenCV counts pixels, and the coefficients.
        kind: Model of the lens.

    Returns:
        Pixels [n, 2], and their derivatives by `own` [n, 2, 4 + coefficients] and by `pose`
        [n, 2, 6].
    """
    fx, fy, cx, cy = own[:4]
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    points, turn, shift = points[:, None], pose[:3, None], pose[3:, None]
    if kind == "fisheye":
        pixels, J = cv2.fisheye.projectPoints(points, turn, shift, K, own[4:, None])
        J = J.reshape(-1, 2, J.shape[-1])
        camera, pose_part = J[..., :8], J[..., 8:14]
    else:
        pixels, J = cv2.projectPoints(points, turn, shift, K, own[4:, None])
        J = J.reshape(-1, 2, J.shape[-1])
        camera, pose_part = J[..., 6:], J[..., :6]
    return pixels.reshape(-1, 2), camera, pose_part


def _start(model: _Model) -> np.ndarray:
    """Unknowns to begin with: the focal length of those tried that fits best, without a lens."""
    width, height = model.size
    best, least = None, np.inf
    for focal in FOCAL * width:
        own = np.array([focal, focal, (width - 1) / 2, (height - 1) / 2, *[0.0] * model.count])
        poses, errors = [], []
        for view in model.views:
            pose = _pose(model.points[view.ids], view.pixels - HALF, own, model.kind)
            if pose is None:
                break
            poses.append(pose)
            off = project_board(model.points[view.ids], pose, own, model.kind)[0]
            errors.append(np.median(np.linalg.norm(off - (view.pixels - HALF), axis=-1)))
        if len(errors) == len(model.views) and np.mean(errors) < least:
            best, least = np.concatenate([own, *poses]), float(np.mean(errors))
    if best is None or least > 0.1 * width:
        raise DatasetError(
            "The corners are not those of a flat board before a camera: no focal length from "
            f"{FOCAL[0]:g} to {FOCAL[-1]:g} widths of the picture explains them."
        )
    return best


def _pose(
    points: np.ndarray, pixels: np.ndarray, own: np.ndarray, kind: LensKind
) -> np.ndarray | None:
    """Pose of a board, roughly, as a rotation vector and a translation."""
    fx, fy, cx, cy = own[:4]
    rays = (pixels - [cx, cy]) / [fx, fy]
    if kind == "fisheye":  # of an angle, its tangent; nothing is behind
        angle = np.linalg.norm(rays, axis=-1, keepdims=True)
        rays = rays * np.tan(np.minimum(angle, 1.45)) / np.maximum(angle, 1e-9)
    middle = points.mean(0)
    done, turn, shift = cv2.solvePnP(
        points - middle, rays, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
    )
    if not done or not np.isfinite([turn, shift]).all():
        return None
    shift = shift[:, 0] - cv2.Rodrigues(turn)[0] @ middle
    return np.concatenate([turn[:, 0], shift])


def _result(model: _Model, fitted: Fitted) -> LensFit:
    own, (width, height) = fitted.values[: model.own], model.size
    K = np.array([[own[0], 0, own[2] + HALF], [0, own[1], own[3] + HALF], [0, 0, 1]])
    poses = fitted.values[model.own :].reshape(-1, 6)
    boards = np.tile(np.eye(4), (len(poses), 1, 1))
    for board, pose in zip(boards, poses, strict=True):
        board[:3, :3], board[:3, 3] = cv2.Rodrigues(pose[:3])[0], pose[3:]
    ends = np.cumsum([len(view.ids) for view in model.views])[:-1]
    packed = np.asarray(lens.pack(own[4:], model.kind))
    optics = Optics(K, width, height, packed)
    covariance = fitted.covariance[: model.own, : model.own]
    return LensFit(
        optics,
        model.kind,
        own[4:],
        np.sqrt(np.maximum(np.diag(covariance), 0)),
        boards,
        model.views,
        tuple(np.split(fitted.residuals, ends)),
        tuple(np.split(fitted.used, ends)),
        fitted.rms,
        _rays(optics, own, covariance, model.kind),
    )


def _rays(optics: Optics, own: np.ndarray, covariance: np.ndarray, kind: LensKind) -> np.ndarray:
    """How far (pixels, standard deviation) the picture of a ray may be off; NaN without a ray."""
    pixels = ray_pixels(optics.width, optics.height)
    x, y = lens.normalised(optics.K, pixels[..., 0], pixels[..., 1])
    sight = np.stack(lens.sight_lines(x, y, optics.distortion, "opencv"), -1)
    has_ray = sight[..., 2] > 0
    slopes = project_board(sight[has_ray].reshape(-1, 3), np.zeros(6), own, kind)[1]
    spread = np.full(GRID, np.nan)
    variance = np.einsum("nij,jk,nik->n", slopes, covariance, slopes)
    spread[has_ray] = np.sqrt(np.maximum(variance, 0))
    return spread
