"""Intrinsics and lenses drawn for the cameras of a dataset or of an evaluation.

K is kept as that of a square picture of height 1, so that it serves pictures of any size: a wider
one shows more at both sides of the same square.
"""
# K is K.
# pyright: reportConstantRedefinition=false

from dataclasses import dataclass

import numpy as np

from jaxcam.errors import ConfigError
from jaxcam.rays._camera import Camera
from jaxcam.rays._poses import Interval
from jaxcam.rays.lens import Lens, pack

_STREAM = 0x0B71C5
"""Tells these random numbers from those of the poses that have the same seed."""
_COLUMNS = 9
"""Numbers drawn for each camera, whatever of them is used: one range moves no other's draws."""


@dataclass(frozen=True)
class OpticsRanges:
    """What cameras may be, uniform in each number and independent of one another.

    Attributes:
        fovy_deg: Vertical field of view (degrees), before the lens.
        aspect: Width over height of what a square picture shows, `fy / fx`: 1.5 is a sensor of
            3:2 whose picture was squeezed into a square.
        centre: Distance between principal point and middle, in heights of the picture; its
            direction in the picture is uniform.
        lens: Model of the coefficients.
        coefficients: Ranges in OpenCV's order; those that are left out are 0, none is a pinhole.

    Raises:
        ConfigError: If there are no such cameras.
    """

    fovy_deg: Interval
    aspect: Interval = (1.0, 1.0)
    centre: Interval = (0.0, 0.0)
    lens: Lens = "opencv"
    coefficients: tuple[Interval, ...] = ()

    def __post_init__(self) -> None:
        for low, high in (self.fovy_deg, self.aspect, self.centre, *self.coefficients):
            if not -1e3 <= low <= high <= 1e3:
                raise ConfigError(f"optics ranges: interval ({low:g}, {high:g}) is empty.")
        if not (self.fovy_deg[0] > 0 and self.fovy_deg[1] < 180 and self.aspect[0] > 0):
            raise ConfigError(f"optics ranges: there are no such cameras: {self}.")


def sample_optics(
    ranges: OpticsRanges, count: int, seed: int
) -> tuple[np.ndarray, np.ndarray | None]:
    """Draw intrinsics; the same seed gives the same ones on every machine, and more go on from few.

    Args:
        ranges: What the cameras may be.
        count: How many.
        seed: That of the cameras' poses.

    Returns:
        K of square pictures of height 1, float64 `[count, 3, 3]`, and packed lenses `[count, 9]`;
        None where all are pinholes.
    """
    generator = np.random.Generator(np.random.Philox(key=[seed, _STREAM]))
    u = generator.random((count, _COLUMNS)).T
    fovy, aspect, distance = (
        _between(interval, u[i])
        for i, interval in enumerate((ranges.fovy_deg, ranges.aspect, ranges.centre))
    )
    K = np.array(Camera.from_fovy(np.deg2rad(fovy), 1, 1).K)
    K[:, 0, 0] /= aspect
    turn = 2 * np.pi * u[3]
    K[:, 0, 2] += distance * np.cos(turn)
    K[:, 1, 2] += distance * np.sin(turn)
    if not ranges.coefficients:
        return K, None
    given = [_between(interval, u[4 + i]) for i, interval in enumerate(ranges.coefficients)]
    least = 4 if len(given) <= 4 else 5
    zeros = [np.zeros(count)] * (least - len(given))
    return K, np.asarray(pack(np.stack([*given, *zeros], -1), ranges.lens))


def at_size(K: np.ndarray, height: int, width: int | None = None) -> np.ndarray:
    """K of pictures of a size.

    Args:
        K: Of square pictures of height 1 `[..., 3, 3]`.
        height: Rows of the pictures.
        width: Columns of them; as many as rows when None.
    """
    width = width or height
    shift = np.zeros((3, 3))
    shift[0, 2] = (width - height) / 2
    return K * np.array([[height], [height], [1.0]]) + shift


def _between(interval: Interval, u: np.ndarray) -> np.ndarray:
    low, high = interval
    return low + (high - low) * u
