"""The look of all figures: one style, no pyplot, colours safe for colour blindness."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

BLUE, VERMILION, INK, GREY, FAINT = (
    "#0072B2", "#D55E00", "#22262B", "#7A828C", "#E3E6EA",
)  # fmt: skip
RATE = LinearSegmentedColormap.from_list("rate", [VERMILION, "#F6EFE6", BLUE])
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "text.color": INK,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 9,
    "axes.labelcolor": INK,
    "axes.edgecolor": GREY,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": FAINT,
    "grid.linewidth": 0.8,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "lines.linewidth": 1.8,
    "svg.fonttype": "none",
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
}
styled = mpl.rc_context(STYLE)  # decorator of the functions that draw


def save(figure: Figure, path: str | Path) -> Path:
    """Write a figure as PNG (160 dpi) or SVG, by the ending of the path.

    Args:
        figure: The figure.
        path: Where it goes; folders are made.

    Returns:
        The path.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context(STYLE):
        figure.savefig(path, dpi=160)
    return path


def panels(
    size: tuple[float, float], columns: int = 1, share_y: bool = False
) -> tuple[Figure, list[Axes]]:
    """A figure of so many inches with its axes side by side."""
    figure = Figure(figsize=size, layout="constrained")
    return figure, list(figure.subplots(1, columns, squeeze=False, sharey=share_y)[0])


def note(axes: Axes, text: str) -> None:
    """Small print above the right end of a panel."""
    axes.text(1, 1.03, text, transform=axes.transAxes, ha="right", color=GREY, fontsize=8.5)


def percent() -> FuncFormatter:
    """Tick labels of a fraction, such as "40 %"."""
    return FuncFormatter(lambda value, _: f"{100 * value:.0f} %")
