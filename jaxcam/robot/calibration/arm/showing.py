"""Pictures for people: the arm's contours on pictures, and what the fit leaves."""

import cv2
import numpy as np
from matplotlib.figure import Figure

from jaxcam.reports.style import BLUE, GREY, VERMILION, side_by_side, styled
from jaxcam.robot.calibration.arm.film import Film
from jaxcam.robot.calibration.arm.refine import Refined
from jaxcam.robot.calibration.page import AWAY, FITTED, SEEN, WIDE, spread_out


def contour_overlays(refined: Refined, film: Film) -> dict[str, np.ndarray]:
    """Pictures with the arm's contour as the pose has it, by what they show, uint8 RGB.

    Args:
        refined: The fit.
        film: Its pictures.
    """
    starts = np.searchsorted(refined.looked.rows, np.arange(len(film.rgb)))
    shown = {}
    for i in spread_out(len(film.rgb)):
        outline = refined.looked.contours[i]
        part = slice(starts[i], starts[i] + len(outline.pixels))
        # The contours are of the round before: moved by what that round still changed.
        ahead = refined.looked.offsets[part] - refined.left[part]
        pixels = outline.pixels + ahead[:, None] * outline.normals
        left = refined.left[part]
        key = (
            f"Episode {film.episodes[i]}, step {film.steps[i]}: the arm's contour as the pose has "
            "it (orange), and edges (blue; left out: violet)."
        )
        edges = pixels + left[:, None] * outline.normals
        counts = refined.looked.clear[part] & (refined.weights[part] > 0.2)
        clear = refined.looked.clear[part]
        shown[key] = _dotted(film.rgb[i], pixels, edges[clear], counts[clear])
    return shown


def _dotted(
    rgb: np.ndarray, fitted: np.ndarray, edges: np.ndarray, counts: np.ndarray
) -> np.ndarray:
    scale = max(1, -(-WIDE // rgb.shape[1]))
    size = rgb.shape[1] * scale, rgb.shape[0] * scale
    picture = cv2.resize(rgb, size, interpolation=cv2.INTER_CUBIC)
    both = ((edges, [SEEN if c else AWAY for c in counts], 2), (fitted, [FITTED] * len(fitted), 1))
    for points, colours, radius in both:
        for (x, y), colour in zip(points * scale - 0.5, colours, strict=True):
            cv2.circle(picture, (round(x * 8), round(y * 8)), radius * 8, colour, -1, cv2.LINE_AA,
                       shift=3)  # fmt: skip
    return picture


@styled
def edge_figure(refined: Refined) -> Figure:
    """How far edges are from contours, in all, and picture by picture."""
    figure, (around, over) = side_by_side((8.2, 3.2), columns=2)
    clear = refined.looked.clear
    left = refined.left[clear]
    limit = max(1.0, 4 * float(np.median(abs(left))) if len(left) else 1.0)
    around.hist(np.clip(left, -limit, limit), 61, color=BLUE)
    around.axvline(0, color=GREY, linewidth=0.8)
    around.set(xlabel="outwards (pixels)", ylabel="points", title="Edges less contours")
    rows = refined.looked.rows[clear]
    numbers = np.unique(rows)
    middle = np.array([np.median(left[rows == i]) for i in numbers])
    spread = np.array([np.median(abs(left[rows == i])) for i in numbers])
    over.plot(numbers, spread, "o", color=BLUE, markersize=3, label="median distance")
    over.plot(numbers, middle, "o", color=VERMILION, markersize=3, label="median, with its sign")
    over.axhline(0, color=GREY, linewidth=0.8)
    over.set(xlabel="picture", ylabel="pixels", title="Picture by picture")
    over.legend(fontsize=8)
    return figure
