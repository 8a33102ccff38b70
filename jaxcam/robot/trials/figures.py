"""The paper's figure of its real-robot experiments: bars of success with half-success on top."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from jaxcam.reports.names import drawn
from jaxcam.reports.style import BLUE, GREY, INK, percent, side_by_side, small_print, styled
from jaxcam.results.stats import Estimate

HALF = "#A9CDE6"
"""Colour of half-success."""
_NAME = 16
"""Letters of a policy's name in a line."""


@dataclass(frozen=True)
class Bar:
    """A policy on a task.

    Attributes:
        name: Of the policy.
        whole: Rate of success.
        half: Rate of success or half-success.
    """

    name: str
    whole: Estimate
    half: Estimate


@styled
def stacked_bars(tasks: Sequence[tuple[str, Sequence[Bar]]]) -> Figure:
    """Bars of success and half-success, a panel for each task.

    Args:
        tasks: Name of each task, and its policies.

    Returns:
        The figure. Whiskers are 95 % intervals, of success at the left, with half-success at the
        right; the numbers are rollouts.
    """
    widest = max(len(bars) for _, bars in tasks)
    width = max(1.6 + 1.25 * widest, 3.6 if len(tasks) > 1 else 5.2)
    figure, panels = side_by_side((width * len(tasks), 3.9), columns=len(tasks), share_y=True)
    for axes, (task, bars) in zip(panels, tasks, strict=True):
        for x, bar in enumerate(bars):
            _draw(axes, x, bar)
        names = ["\n".join(textwrap.wrap(drawn(bar.name), _NAME)) for bar in bars]
        axes.set_xticks(range(len(bars)), names)
        axes.set(ylim=(0, 1.0), xlim=(-0.7, len(bars) - 0.3), title=drawn(task))
        axes.yaxis.set_major_formatter(percent())
        axes.grid(axis="x", visible=False)
        counts = {bar.whole.n for bar in bars}
        most = f" to {max(counts)}" if len(counts) > 1 else ""
        small_print(axes, f"n = {min(counts)}{most}")
    patches = [Patch(color=BLUE, label="success"), Patch(color=HALF, label="half-success")]
    figure.legend(handles=patches, loc="outside lower center", ncols=2)
    return figure


def _draw(axes: Axes, x: int, bar: Bar) -> None:
    if not bar.whole.n:
        axes.text(x, 0.02, "none yet", ha="center", color=GREY, fontsize=8.5)
        return
    whole, half = bar.whole.value, bar.half.value
    axes.bar(x, whole, 0.62, color=BLUE)
    axes.bar(x, half - whole, 0.62, bottom=whole, color=HALF)
    for place, rate in ((x - 0.12, bar.whole), (x + 0.12, bar.half)):
        axes.plot([place] * 2, [rate.low, rate.high], color=INK, linewidth=1.1)
    n = bar.whole.n
    for rate, below, colour in ((whole, 0.0, "white"), (half, whole, INK)):
        if rate - below > 0.06:
            count = str(round((rate - below) * n))
            axes.text(x - 0.21, below + 0.015, count, color=colour, fontsize=9, ha="center")
