"""Recorded pictures brought to the size that a policy sees, and K with them.

A picture is scaled as far as it fits, and what then lacks on two sides is black: nothing of it is
cut off or bent. This and `jaxcam.models.crops` are the only places where pictures change.
"""

from dataclasses import dataclass

import cv2
import numpy as np


@dataclass(frozen=True)
class Fit:
    """How pictures of one size become those of another; made by `fit`."""

    height: int
    """Rows of the result."""
    width: int
    """Columns of the result."""
    inner: tuple[int, int]
    """Rows and columns that the picture itself takes of it."""
    corner: tuple[int, int]
    """Row and column where it begins."""
    zoom: tuple[float, float]
    """Its columns and rows a pixel of the recorded picture becomes, (x, y)."""

    def intrinsics(self, K: np.ndarray) -> np.ndarray:
        """Intrinsics [..., 3, 3] of the recorded pictures as those of the results, float64."""
        (top, left), (x, y) = self.corner, self.zoom
        moves = np.array([[x, 0, left], [0, y, top], [0, 0, 1]])
        return moves @ np.asarray(K, np.float64)

    def picture(self, picture: np.ndarray) -> np.ndarray:
        """A recorded picture as the policy sees it, uint8 [height, width, 3]."""
        rows, columns = self.inner
        if picture.shape[:2] != self.inner:
            shrinks = rows * columns < picture.shape[0] * picture.shape[1]
            method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
            picture = cv2.resize(picture, (columns, rows), interpolation=method)
        if self.inner == (self.height, self.width):
            return picture
        whole = np.zeros((self.height, self.width, 3), np.uint8)
        top, left = self.corner
        whole[top : top + rows, left : left + columns] = picture
        return whole


def fit(recorded: tuple[int, int], wanted: tuple[int, int]) -> Fit:
    """How pictures are brought to a size.

    Args:
        recorded: Rows and columns of the recorded pictures.
        wanted: Those of the result.
    """
    scale = min(wanted[0] / recorded[0], wanted[1] / recorded[1])
    # A rounded side may miss the wanted one by a pixel, which is not worth a black line.
    inner = [max(1, round(side * scale)) for side in recorded]
    inner = [w if abs(w - i) <= 1 else i for i, w in zip(inner, wanted, strict=True)]
    return Fit(
        *wanted,
        inner=(inner[0], inner[1]),
        corner=((wanted[0] - inner[0]) // 2, (wanted[1] - inner[1]) // 2),
        zoom=(inner[1] / recorded[1], inner[0] / recorded[0]),
    )


def keeping_shape(recorded: tuple[int, int], shorter: int, multiple: int = 4) -> tuple[int, int]:
    """Rows and columns of pictures whose shorter side is given, shaped like the recorded ones.

    Args:
        recorded: Rows and columns of the recorded pictures.
        shorter: The shorter side (pixels).
        multiple: Both sides are multiples of it, as encoders want.
    """
    scale = shorter / min(recorded)
    rows, columns = (max(1, round(side * scale / multiple)) * multiple for side in recorded)
    return rows, columns
