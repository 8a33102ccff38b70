"""Corners of tags to a few hundredths of a pixel, from all of their sides.

OpenCV's refinements of a tag's corners look at the corners alone, and are off by some tenths of a
pixel. A side is straight once the lens is undone: where black becomes white is measured across it
at many places, a line is laid through them, and the corners are where the lines meet.
"""

import cv2
import numpy as np

from jaxcam.interop.cameras.optics import Optics
from jaxcam.robot.calibration.projection import HALF, pixels_of, straightened

ALONG = np.linspace(0.12, 0.88, 31)
"""Places along a side; its ends are other sides' too."""
ACROSS = 33
"""Samples of a profile."""
CELLS = 0.65
"""How far a profile reaches to each side, in cells: inside and outside, one cell is plain."""
WIDEST, NARROWEST = 4.0, 1.0
"""Likewise in pixels."""
CONTRAST = 0.3
"""Profiles with less of the side's contrast do not count: something is in front of them."""


def refine_corners(grey: np.ndarray, corners: np.ndarray, cells: int, optics: Optics) -> np.ndarray:
    """Corners of a tag, from its sides.

    Args:
        grey: The picture, uint8 [H, W].
        corners: Roughly, from the upper left one clockwise, [4, 2].
        cells: Of the tag along a side, its black border included.
        optics: How the camera sees.

    Returns:
        Pixels [4, 2]; as given where the sides cannot be measured.
    """
    start = corners
    for _ in range(2):
        lines = _lines(grey, corners, cells, optics)
        if lines is None:
            return start
        meeting = np.cross(np.roll(lines, 1, 0), lines)
        if (np.abs(meeting[:, 2]) < 1e-12).any():
            return start
        corners = pixels_of(meeting / meeting[:, 2:], optics)
        if not (np.linalg.norm(corners - start, axis=-1) < WIDEST).all():
            return start
    return corners


def _lines(grey: np.ndarray, corners: np.ndarray, cells: int, optics: Optics) -> np.ndarray | None:
    """The four sides as lines in normalised coordinates, [4, 3]: from each corner to the next."""
    flat = straightened(corners, optics)
    if not np.isfinite(flat).all():
        return None
    ends = np.roll(flat, -1, 0)
    line = flat[:, None] + ALONG[:, None] * (ends - flat)[:, None]  # [4, places, 2]
    at = pixels_of(np.concatenate([line, np.ones((*line.shape[:2], 1))], -1), optics)
    along = np.gradient(at, axis=1)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    out = np.stack([along[..., 1], -along[..., 0]], -1)  # clockwise: the left is outside
    shortest = np.linalg.norm(np.roll(corners, -1, 0) - corners, axis=-1).min()
    reach = float(np.clip(CELLS * shortest / cells, NARROWEST, WIDEST))
    t = np.linspace(-reach, reach, ACROSS)
    samples = (at[..., None, :] + t[:, None] * out[..., None, :] - HALF).astype(np.float32)
    flat_samples = samples.reshape(4 * len(ALONG), ACROSS, 2)
    light = cv2.remap(grey, flat_samples[..., 0], flat_samples[..., 1], cv2.INTER_LINEAR,
                      borderMode=cv2.BORDER_REPLICATE)  # fmt: skip
    light = light.reshape(4, len(ALONG), ACROSS).astype(float)
    plain = ACROSS // 5
    low = _smooth(light[..., :plain].mean(-1))
    contrast = _smooth(light[..., -plain:].mean(-1)) - low
    usual = np.median(contrast, -1, keepdims=True)
    good = contrast > np.maximum(CONTRAST * usual, 8)
    if (good.sum(-1) < len(ALONG) // 3).any():
        return None
    white = ((light - low[..., None]) / np.where(good, contrast, 1)[..., None]).mean(-1)
    offset = reach - 2 * reach * white  # as much white as if it began there
    good &= np.abs(offset) < reach
    points = straightened(at + offset[..., None] * out, optics)
    return np.stack([_line(p, g) for p, g in zip(points, good, strict=True)])


def _smooth(values: np.ndarray) -> np.ndarray:
    """Over neighbours along the side: light changes slowly, noise does not. [4, places]."""
    return cv2.blur(values, (7, 1), borderType=cv2.BORDER_REPLICATE)


def _line(points: np.ndarray, good: np.ndarray) -> np.ndarray:
    """The line through points, [3]; those far off do not count."""
    for _ in range(2):
        middle = points[good].mean(0)
        normal = np.linalg.svd(points[good] - middle)[2][1]
        off = np.abs((points - middle) @ normal)
        good = good & (off <= max(3 * 1.4826 * float(np.median(off[good])), 1e-9))
    middle = points[good].mean(0)
    normal = np.linalg.svd(points[good] - middle)[2][1]
    return np.array([*normal, -normal @ middle])
