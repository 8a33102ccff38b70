"""Figures of many arms: grouped bars, curves over the number of cameras, maps of success."""

import math
import textwrap
from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from jaxcam.reports.arms import Arm
from jaxcam.reports.camera_figures import angle_ticks, draw_cameras, rate_by_camera
from jaxcam.reports.names import drawn
from jaxcam.reports.paper import policy_title, task_title
from jaxcam.reports.studies import CONDITIONINGS, Panel, arms_of
from jaxcam.reports.style import (
    GREY,
    INK,
    RATE,
    band,
    beside,
    interval,
    legend_below,
    percent,
    rates_and_differences,
    side_by_side,
    styled,
)
from jaxcam.reports.tables import paper_value
from jaxcam.results.stats import p_text

COLOURS = {"none": "#7A828C", "token": "#CC79A7", "early": "#E69F00", "late": "#0072B2",
           "keypoints": "#009E73", "warp": "#8C6D31", "prope": "#6A3D9A", "gta": "#56B4E9",
           "ray_rope": "#A50F15"}  # fmt: skip
_NAMES = {"none": "image only"}
_OTHER = "#D55E00"
"""Of a conditioning that is not ours, in rows that somebody else wrote."""
_COLUMNS = 3
_LETTERS = 5
"""Letters that find room under a bar."""
_TURNED = 26
"""Letters of a label that is turned."""


def colour_of(arm: Arm) -> str:
    """The colour of an arm's conditioning."""
    return COLOURS.get(arm.settings["conditioning"], _OTHER)


@styled
def bars(shown: Sequence[Panel], names: Mapping[Any, str]) -> Figure:
    """Success by the values of one setting and by conditioning.

    Args:
        shown: One panel a task; each bar has its interval and its number of rollouts.
        names: Of the values.

    Returns:
        The figure. Bars of fewer rollouts than the protocol asks for are hatched; diamonds are the
        paper's numbers.
    """
    widest = max(sum(len(arms) for arms in panel.arms.values()) for panel in shown)
    width = max(1.1 + 0.42 * widest, 4.0 / len(shown))  # 4 inches hold the legend
    figure, grid = panel_grid(len(shown), (width, 3.4))
    turned = False
    for axes, panel in zip(grid, shown, strict=True):
        place = 0.0
        ticks = []
        for arms in panel.arms.values():
            at = place + np.arange(len(arms))
            for x, arm in zip(at, arms.values(), strict=True):
                _bar(axes, float(x), arm)
            ticks.append(at.mean())
            place = at[-1] + 1.6
        axes.set(ylim=(0, 1), xlim=(-0.8, place - 0.8))
        _title(axes, panel.title)
        room = int(_LETTERS * min(np.diff(ticks), default=place))
        lines = [textwrap.wrap(names[v], room, break_long_words=False) for v in panel.arms]
        long = any(len(line) > room for words in lines for line in words)
        if long:
            lines = [[_short(names[v])] for v in panel.arms]
            turned = True
        labels = [drawn("\n".join(words)) for words in lines]
        axes.set_xticks(ticks, labels, rotation=20 if long else 0,
                        ha="right" if long else "center")  # fmt: skip
        _rates(axes)
    if turned:
        figure.set_figheight(1.2 * figure.get_figheight())
    _legend(figure, arms_of(shown), Patch)
    return figure


def _short(name: str) -> str:
    """A name of at most as many letters as a turned label has room for."""
    return name if len(name) <= _TURNED else f"{name[: _TURNED - 12]}…{name[-11:]}"


@styled
def curves(shown: Sequence[Panel], label: str) -> Figure:
    """Success over a number, on a logarithmic axis, one curve for each conditioning.

    Args:
        shown: One panel a task.
        label: What the number is.
    """
    figure, grid = panel_grid(len(shown), (4.4, 3.5))
    for axes, panel in zip(grid, shown, strict=True):
        for way in dict.fromkeys(way for arms in panel.arms.values() for way in arms):
            _curve(axes, {x: arms[way] for x, arms in panel.arms.items() if way in arms})
        axes.set(xscale="log", ylim=(0, 1), xlabel=label)
        _title(axes, panel.title)
        axes.xaxis.set_major_locator(FixedLocator(list(panel.arms)))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        _rates(axes)
    _legend(figure, arms_of(shown), Line2D, papers=False)
    return figure


@styled
def rates_and_gains(twins: Sequence[tuple[Arm, Arm]]) -> Figure:
    """Success with and without the camera pose, and their paired difference.

    Args:
        twins: A conditioned arm and its image-only twin, each.

    Returns:
        The figure: at the left both rates, at the right the differences; diamonds are the paper's.
    """
    figure, (left, right) = side_by_side((9.6, 1.3 + 0.42 * len(twins)), columns=2, share_y=True)
    for y, (arm, twin) in enumerate(twins):
        colour = colour_of(arm)
        for one, shade, height in ((twin, COLOURS["none"], y + 0.15), (arm, colour, y - 0.15)):
            e = one.estimate
            interval(left, height, (e.value, e.low, e.high), shade, hollow=bool(one.lacks))
            if (value := paper_value(one)) is not None:
                _diamond(left, value / 100, height)
        delta = arm.against(twin)
        interval(right, y, (delta.value, delta.low, delta.high), colour,
                 hollow=bool(arm.lacks or twin.lacks))  # fmt: skip
        papers = paper_value(arm), paper_value(twin)
        if papers[0] is not None and papers[1] is not None:
            _diamond(right, (papers[0] - papers[1]) / 100, y)
        beside(right, y, f"{100 * delta.value:+.1f}  p {p_text(delta.p_value)}  "
                         f"n = {arm.estimate.n}, {twin.estimate.n}")  # fmt: skip
    rates_and_differences(left, right, [_twin_name(arm) for arm, _ in twins])
    _legend(figure, [arm for some in twins for arm in some], Line2D)
    return figure


@styled
def maps(arms: Sequence[Arm]) -> Figure:
    """Success over the sphere of cameras, a panel for each conditioning.

    Args:
        arms: Of one task, with rows that have angles.
    """
    figure, grid = panel_grid(len(arms), (3.9, 2.9))
    across, up = angle_ticks(np.concatenate([rate_by_camera(arm.rows) for arm in arms]))
    for axes, arm in zip(grid, arms, strict=True):
        draw_cameras(axes, rate_by_camera(arm.rows), across, up, scale=0.5)
        way, e = arm.way, arm.estimate
        name = drawn(_NAMES.get(way) or str(way))
        axes.set_title(f"{name}: {100 * e.value:.1f} %, n = {arm.count()}")
        axes.set(xlabel="azimuth (degrees)", ylabel="elevation (degrees)")
    bar = figure.colorbar(
        ScalarMappable(Normalize(0, 1), RATE), ax=grid, alpha=0.55, ticks=[0, 0.5, 1],
        format=percent(), fraction=0.05, aspect=22,
    )  # fmt: skip
    bar.set_label("smoothed success")
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    return figure


def panel_grid(count: int, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """Panels of so many inches, in rows of three."""
    columns = min(count, _COLUMNS)
    rows = math.ceil(count / columns)
    figure = Figure(figsize=(columns * size[0], rows * size[1]), layout="constrained")
    grid = list(chain.from_iterable(figure.subplots(rows, columns, squeeze=False)))
    for empty in grid[count:]:
        empty.remove()
    return figure, grid[:count]


def _curve(axes: Axes, arms: Mapping[Any, Arm]) -> None:
    """Success of arms of one conditioning by a number, with intervals."""
    colour = colour_of(next(iter(arms.values())))
    band(axes, [*arms], [arm.estimate for arm in arms.values()], color=colour)
    for x, arm in arms.items():
        face = "white" if arm.lacks else colour
        axes.plot(x, arm.estimate.value, "o", color=colour, markerfacecolor=face)


def _bar(axes: Axes, x: float, arm: Arm) -> None:
    e, colour = arm.estimate, colour_of(arm)
    axes.bar(x, e.value, 0.86, color=colour, alpha=0.55 if arm.lacks else 1.0,
             hatch="///" if arm.lacks else None, edgecolor="white", linewidth=0)  # fmt: skip
    axes.plot([x, x], [e.low, e.high], color=INK, linewidth=1.4)
    text = f"{100 * e.value:.0f} %  n = {e.n}"
    top = e.high
    if (value := paper_value(arm)) is not None:
        _diamond(axes, x, value / 100)
        top = max(top, value / 100 + 0.02)
    above = top < 0.62  # else there is no room, and the bar is tall enough to hold it
    dark = not above and not arm.lacks
    halo = withStroke(linewidth=2.2, foreground=colour if dark else "white")  # hatching, grid lines
    axes.text(x, top + 0.015 if above else 0.02, text, rotation=90, ha="center", va="bottom",
              fontsize=7.5, color="white" if dark else INK, path_effects=[halo])  # fmt: skip


def _diamond(axes: Axes, x: float, y: float) -> None:
    axes.plot(x, y, "D", color="white", markeredgecolor=INK, markersize=4.5, zorder=4)


def _title(axes: Axes, title: str) -> None:
    """The first line large, what is particular below it."""
    first, _, rest = drawn(title).partition("\n")
    below = textwrap.fill(rest, 34, break_long_words=False)
    axes.set_title(first, pad=8 + 10 * (1 + below.count("\n")))
    axes.text(0, 1.03, below, transform=axes.transAxes, color=GREY, fontsize=8, va="bottom")


def _twin_name(arm: Arm) -> str:
    s = arm.settings
    label = arm.label("views", "n", "m").removeprefix("paper preset").removeprefix(", ")
    words = filter(None, [policy_title(s["policy"]), task_title(s["task"]), arm.way, label])
    return textwrap.fill(drawn(", ".join(words)), 32, break_long_words=False)


def _rates(axes: Axes) -> None:
    axes.yaxis.set_major_formatter(percent())
    axes.grid(axis="x", visible=False)


def _legend(
    figure: Figure, arms: Sequence[Arm], kind: type[Patch] | type[Line2D], *, papers: bool = True
) -> None:
    """Colours of the conditionings, the sign of missing rollouts, and the paper's."""
    ways = {arm.settings["conditioning"] for arm in arms}
    handles: list[Any] = []
    for way in CONDITIONINGS:
        if way in ways:
            mark = (
                Patch(color=COLOURS[way]) if kind is Patch else Line2D([], [], color=COLOURS[way])
            )
            mark.set_label(_NAMES.get(way, way))
            handles.append(mark)
    if any(arm.lacks for arm in arms):
        lacking = "fewer rollouts than the protocol"
        handles.append(
            Patch(facecolor=GREY, alpha=0.55, hatch="///", edgecolor="white", label=lacking)
            if kind is Patch
            else Line2D([], [], marker="o", color=GREY, markerfacecolor="white", linestyle="",
                        label=lacking)
        )  # fmt: skip
    if papers and any(paper_value(arm) is not None for arm in arms):
        handles.append(Line2D([], [], marker="D", color="white", markeredgecolor=INK, linestyle="",
                              markersize=5, label="paper"))  # fmt: skip
    legend_below(figure, {str(handle.get_label()): handle for handle in handles})
