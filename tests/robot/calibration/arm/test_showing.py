"""What is shown of a calibration by the arm."""

import numpy as np
from boxed_arm import CAMERA, boxed_arm, film
from matplotlib.axes import Axes

from jaxcam.robot.calibration.arm.refine import Refiner, Solution
from jaxcam.robot.calibration.arm.showing import contour_overlays, edge_figure
from jaxcam.robot.calibration.page import FITTED


def test_contours_are_drawn_on_pictures_and_residuals_beside_them():
    shown_film = film([CAMERA] * 2, count=4)
    refined = Refiner(boxed_arm(), shown_film).refine(Solution(CAMERA, np.zeros(3), 0.0), (4.0,))
    shown = contour_overlays(refined, shown_film)
    assert len(shown) == 6
    first = next(iter(shown))
    assert first.startswith("Episode 0, step 0")
    drawn = (abs(shown[first].astype(int) - FITTED).max(-1) < 40).sum()
    assert drawn > 100
    axes = [ax for ax in edge_figure(refined).axes if isinstance(ax, Axes)]
    assert [ax.get_title("left") for ax in axes] == ["Edges less contours", "Picture by picture"]
