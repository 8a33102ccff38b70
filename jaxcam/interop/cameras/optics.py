"""How a camera sees: K with the size that it is for, and the lens."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from jaxcam.config.fields import as_record, short
from jaxcam.errors import CameraError, ConfigError
from jaxcam.interop.cameras.poses import real_numbers
from jaxcam.rays import Camera, lens

LensName = Literal["pinhole", "opencv", "fisheye"]
"""Models of a lens in files of calibrations; a pinhole has no coefficients."""
PIXEL_CENTERS = (0.5, 0.0)
"""Where the centre of the first pixel may be: here, and in OpenCV's calibrations."""


@dataclass(frozen=True)
class FourNumbers:
    """K without a skew."""

    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True)
class Optics:
    """How a camera sees pictures of one size."""

    K: np.ndarray
    """Intrinsics in pixels of that size, whose corner is (0, 0), float64 [3, 3]."""
    width: int
    """Columns."""
    height: int
    """Rows."""
    distortion: np.ndarray
    """The lens, of either model, as `jaxcam.rays.lens.pack` gives it, float64 [9]."""

    def at(self, height: int, width: int, where: str) -> np.ndarray:
        """K for pictures of another size, of which these were scaled evenly, float64 [3, 3].

        Args:
            height: Their rows.
            width: Their columns.
            where: Whose it is, for the message.

        Raises:
            CameraError: They have another shape.
        """
        # A scaled side is rounded to a whole number of pixels.
        odd_width = abs(width - self.width * height / self.height)
        odd_height = abs(height - self.height * width / self.width)
        if min(odd_width, odd_height) >= 1:
            raise CameraError(
                f"{where}: K for another size that does not scale evenly: K is for "
                f"{self.width}x{self.height}, the pictures are {width}x{height}. Likely cause: "
                "they were cropped, or scaled by two factors. Give K for their own size: a crop "
                "moves cx and cy, a scale multiplies each row of K by its own factor."
            )
        camera = Camera(self.K, np.eye(4), self.height, self.width)
        return np.asarray(camera.resize(height, width).K)


def optics_of(entry: Mapping[str, Any], where: str) -> Optics | None:
    """What the entries of a view say of how it sees.

    Args:
        entry: `K`, `size` (width, height), `pixel_centers`, `lens` and `distortion`, each None
            where nobody says.
        where: Whose they are, for messages.

    Returns:
        None where there is no K.

    Raises:
        ConfigError: Something is missing or of another kind.
        CameraError: No camera is like that.
    """
    distortion = _lens_of(entry["lens"], entry["distortion"], where)
    if entry["K"] is None:
        return None
    if entry["size"] is None:
        raise ConfigError(f"{where}: K without 'size', the [width, height] that it is for.")
    width, height = entry["size"]
    first = 0.5 if entry["pixel_centers"] is None else entry["pixel_centers"]
    if first not in PIXEL_CENTERS:
        raise ConfigError(
            f"{where}: pixel_centers is the coordinate of the first pixel's centre, 0.5 or, in "
            f"OpenCV's calibrations, 0; got {short(first)}."
        )
    K = _matrix_of(entry["K"], where)
    K = K + (0.5 - first) * np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0]])
    Camera(K, np.eye(4), height, width).validate(f"{where}: K")
    return Optics(K, width, height, distortion)


def _matrix_of(value: Any, where: str) -> np.ndarray:
    if isinstance(value, dict):
        four = as_record(FourNumbers, value, f"{where}, K")
        return np.array([[four.fx, 0, four.cx], [0, four.fy, four.cy], [0, 0, 1]], np.float64)
    K = real_numbers(value, f"{where}: K")
    if K.shape != (3, 3):
        raise CameraError(
            f"{where}: K has shape {list(K.shape)}; expected three rows of three numbers, or "
            '{"fx": …, "fy": …, "cx": …, "cy": …}.'
        )
    return K


def _lens_of(
    name: LensName | None, coefficients: tuple[float, ...] | None, where: str
) -> np.ndarray:
    if not coefficients:
        if name in ("opencv", "fisheye"):
            raise ConfigError(f"{where}: a lens '{name}' without 'distortion', its coefficients.")
        return np.zeros(lens.PACKED)
    if name == "pinhole":
        raise ConfigError(f"{where}: a pinhole has no distortion. Say 'opencv' or 'fisheye'.")
    if len(coefficients) == lens.PACKED:
        raise CameraError(
            f"{where}: nine coefficients of distortion; expected 4, 5 or 8 of the lens 'opencv', "
            "or 4 of 'fisheye'."
        )
    model = "fisheye" if name == "fisheye" else "opencv"
    values = np.asarray(coefficients, np.float64)
    lens.check_distortion(values, model, where)
    return np.asarray(lens.pack(values, model))
