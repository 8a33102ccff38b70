"""The look of all figures: one style, no pyplot, colours safe for colour blindness."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from jaxcam.files.whole import whole
from jaxcam.reports.names import drawn
from jaxcam.results.stats import Estimate

BLUE, VERMILION, INK, GREY, FAINT = (
    "#0072B2", "#D55E00", "#22262B", "#7A828C", "#E3E6EA",
)  # fmt: skip
RATE = LinearSegmentedColormap.from_list("rate", [VERMILION, "#F6EFE6", BLUE])
_MARKERS = "os^Dv*P"
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
    "legend.handlelength": 3.2,
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
    with mpl.rc_context(STYLE), whole(path) as part:
        figure.savefig(part, dpi=160)
    return path


def side_by_side(
    size: tuple[float, float], columns: int = 1, share_y: bool = False
) -> tuple[Figure, list[Axes]]:
    """A figure of so many inches with its axes side by side."""
    figure = Figure(figsize=size, layout="constrained")
    return figure, list(figure.subplots(1, columns, squeeze=False, sharey=share_y)[0])


def legend_below(figure: Figure, handles: Mapping[str, Artist]) -> None:
    """A legend below the panels, in as many columns as the figure is wide.

    Args:
        figure: Where.
        handles: What stands for each name.
    """
    for columns in range(len(handles), 0, -1):
        legend = figure.legend([*handles.values()], [drawn(name) for name in handles],
                               loc="outside lower center", ncols=columns)  # fmt: skip
        size = legend.get_window_extent()
        if columns == 1 or size.width <= figure.bbox.width:
            # What is more than a quarter of the figure comes on top of it.
            more = max(0.0, size.height - figure.bbox.height / 4)
            figure.set_figheight(figure.get_figheight() + more / figure.dpi)
            return
        legend.remove()


def tell_apart(names: Sequence[str], more: Sequence[str]) -> list[str]:
    """Names of the curves of a panel: those that are not the only ones have more said of them.

    Args:
        names: Of the curves.
        more: What else there is to say of each.
    """
    many = Counter(names)
    return [
        f"{name}, {words}" if many[name] > 1 and words else name
        for name, words in zip(names, more, strict=True)
    ]


def distinct(looks: Mapping[str, tuple[str, str]]) -> dict[str, dict[str, Any]]:
    """How curves are drawn: those that would look alike have markers of their own.

    Args:
        looks: Colour and dashes of each curve, by its name.

    Returns:
        What `band`, and a line in a legend, take of each.
    """
    alike: Counter[tuple[str, str]] = Counter()
    drawn_as = {}
    for name, look in looks.items():
        round_, marker = divmod(alike[look], len(_MARKERS))
        drawn_as[name] = {"color": look[0], "linestyle": look[1], "marker": _MARKERS[marker]}
        if round_:  # open ones
            drawn_as[name]["markerfacecolor"] = "white"
        alike[look] += 1
    return drawn_as


def band(axes: Axes, x: Sequence[float], estimates: Sequence[Estimate], **look: Any) -> None:
    """Success over a number as a curve, and its intervals as a band.

    Args:
        axes: Where.
        x: The numbers.
        estimates: Success at each.
        **look: Colour, and whatever else `Axes.plot` takes.
    """
    axes.plot(x, [e.value for e in estimates], **look)
    low, high = [e.low for e in estimates], [e.high for e in estimates]
    axes.fill_between(x, low, high, color=look["color"], alpha=0.13, linewidth=0)


def small_print(axes: Axes, text: str) -> None:
    """Small print above the right end of a panel."""
    axes.text(1, 1.03, text, transform=axes.transAxes, ha="right", color=GREY, fontsize=8.5)


def percent() -> FuncFormatter:
    """Tick labels of a fraction, such as "40 %"."""
    return FuncFormatter(lambda value, _: f"{100 * value:.0f} %")


def interval(
    axes: Axes, y: float, estimate: tuple[float, float, float], colour: str, *, hollow: bool = False
) -> None:
    """A point with its interval along x: value, low and high."""
    value, low, high = estimate
    axes.plot([low, high], [y, y], color=colour, linewidth=2.4, solid_capstyle="round")
    face, edge = ("white", colour) if hollow else (colour, "white")
    axes.plot(value, y, "o", color=face, markersize=7, markeredgecolor=edge)


def beside(axes: Axes, y: float, text: str) -> None:
    """Text in the right margin, at the height of one arm."""
    axes.text(1.03, y, text, transform=axes.get_yaxis_transform(), va="center", fontsize=8.5)


def rates_and_differences(left: Axes, right: Axes, names: Sequence[str]) -> None:
    """The axes of two panels that share their lines: rates, and differences in points.

    Args:
        left: The panel of rates.
        right: The panel of differences.
        names: Of the lines, from the top.
    """
    left.set(xlim=(0, 1), ylim=(len(names) - 0.5, -0.5), xlabel="success, 95 % interval")
    left.set_yticks(range(len(names)), names)
    left.xaxis.set_major_formatter(percent())
    right.axvline(0, color=INK, linewidth=1, zorder=1)
    right.xaxis.set_major_formatter(
        FuncFormatter(lambda value, _: f"{100 * value:+.0f}" if value else "0")
    )
    right.set_xlabel("points, paired, 95 % interval")
    for axes in (left, right):
        axes.grid(axis="y", visible=False)
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
