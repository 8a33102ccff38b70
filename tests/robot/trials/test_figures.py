"""The bars of success and half-success."""

import pytest

from jaxcam.results.stats import Estimate
from jaxcam.robot.trials.figures import HALF, Bar, stacked_bars


def test_half_success_stands_on_success():
    bars = [
        Bar("With a $long$ name", Estimate(2 / 3, 0.4, 0.9, 21, 7), Estimate(1, 0.8, 1, 21, 7)),
        Bar("None yet", Estimate(float("nan"), 0, 1, 0, 0), Estimate(float("nan"), 0, 1, 0, 0)),
    ]  # fmt: skip
    figure = stacked_bars([("Pick Place", bars), ("Hang Mug", bars)])
    first, second = figure.axes
    whole, half = first.patches
    assert (whole.get_height(), half.get_y()) == pytest.approx((2 / 3, 2 / 3))
    assert half.get_height() == pytest.approx(1 / 3)
    assert half.get_facecolor()[:3] == pytest.approx(
        [int(HALF[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    )
    texts = [text.get_text() for text in first.texts]
    assert {"14", "7", "none yet", "n = 0 to 21"} <= set(texts)
    assert second.get_title(loc="left") == "Hang Mug"
