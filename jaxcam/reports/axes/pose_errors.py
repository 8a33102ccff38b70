"""Success over errors of the poses that policies are told, and the error that halves the gain."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxcam.config.conditions import Span, degrees_and_cm
from jaxcam.reports import paper
from jaxcam.reports.arms import Arm, ImageOnlyArms, context
from jaxcam.reports.document import Block, Heading, Picture, Table
from jaxcam.reports.names import drawn
from jaxcam.reports.study_figures import colour_of, panel_grid
from jaxcam.reports.style import (
    GREY,
    INK,
    RATE,
    band,
    distinct,
    legend_below,
    percent,
    save,
    styled,
    tell_apart,
)
from jaxcam.reports.tables import NONE, by_task
from jaxcam.results.halving import halving_error

_AXES = {
    "rotation": "rotation (degrees)",
    "translation": "translation (cm)",
    "both": "rotation (degrees) and translation (cm)",
}
_FIELDS = ("eval_pose_noise", "eval_pose_drift")


@dataclass(frozen=True)
class ErrorCurve:
    """One policy under several errors of what it is told.

    Attributes:
        field: Which error: `eval_pose_noise`, or `eval_pose_drift`, by the second.
        arms: By degrees and centimetres; (0, 0) is there.
        image_only: The policy that is told nothing; None where it was not run.
    """

    field: str
    arms: Mapping[Span, Arm]
    image_only: Arm | None

    @property
    def clean(self) -> Arm:
        """Without an error."""
        return self.arms[0.0, 0.0]

    @property
    def name(self) -> str:
        """What tells it from others of its panel."""
        s = self.clean.settings
        size, per = s.get("pose_noise"), s.get("pose_noise_per", "sample")
        return f"{s['conditioning']}, trained with {size} by {per}" if size else s["conditioning"]

    def along(self, axis: str) -> dict[float, Arm]:
        """The arms along an axis of `_AXES`, by the error, ascending from 0.

        Args:
            axis: Its name; along both, degrees are as many as centimetres.
        """
        ways = {"rotation": lambda d, c: c == 0, "translation": lambda d, c: d == 0,
                "both": lambda d, c: c == d}  # fmt: skip
        return {max(at): arm for at, arm in sorted(self.arms.items()) if ways[axis](*at)}


def error_curves(arms: Sequence[Arm]) -> list[ErrorCurve]:
    """Every policy that was told poses with errors and without.

    Args:
        arms: All there are.
    """
    base = ImageOnlyArms([arm for arm in arms if not any(map(arm.settings.get, _FIELDS))])
    curves: list[ErrorCurve] = []
    for field in _FIELDS:
        groups: dict[str, dict[Span, Arm]] = {}
        for some in by_task(arm for arm in arms if arm.estimate.n).values():
            for arm in some:
                at = degrees_and_cm(arm.settings.get(field) or "")
                groups.setdefault(context(arm, field), {})[at] = arm
        for levels in groups.values():
            if len(levels) > 1 and (0.0, 0.0) in levels:
                other = base.of(levels[0.0, 0.0])
                curves.append(ErrorCurve(field, levels, other and other.arm))
    return curves


def pose_error_blocks(arms: Sequence[Arm], out: Path) -> list[Block]:
    """What a report says of errors of the poses; nothing where none were tried.

    Args:
        arms: All there are.
        out: Folder of the report.
    """
    blocks: list[Block] = []
    for field in _FIELDS:
        some = [curve for curve in error_curves(arms) if curve.field == field]
        if not some:
            continue
        drifts = field == "eval_pose_drift"
        what = "Poses that drift" if drifts else "Errors of the poses that policies are told"
        name = field.removeprefix("eval_")
        save(over_errors(some), out / "figures" / f"{name}.png")
        units = " by the second" if drifts else ""
        caption = (
            f"Success over the error{units}, with 95 % intervals over pairs; dashed: trained with "
            "errors; grey: the image-only policy, which no such error reaches."
        )
        blocks += [Heading(what), Picture(f"figures/{name}.png", caption)]
        if grids := [c for c in some if sum(bool(d and cm) for d, cm in c.arms) > 1]:
            save(error_maps(grids), out / "figures" / f"{name}_grid.png")
            words = f"Success in percent by both parts of the error{units}."
            blocks.append(Picture(f"figures/{name}_grid.png", words))
        blocks.append(_halving_table(some, units))
    return blocks


def _halving_table(curves: Sequence[ErrorCurve], units: str) -> Table:
    rows: list[list[str]] = []
    for curve in curves:
        e = curve.clean.estimate
        halves = [_halves(curve, axis) for axis in _AXES]
        s = curve.clean.settings
        rows.append([
            paper.policy_title(s["policy"]), paper.task_title(s["task"]), curve.name,
            curve.clean.label("pose_noise", "pose_noise_per"),
            f"{100 * e.value:.1f} [{100 * e.low:.1f}, {100 * e.high:.1f}]", *halves,
        ])  # fmt: skip
    head = ("Policy", "Task", "Conditioning", "Settings", "Without error",
            *(f"Half at {label}" for label in _AXES.values()))  # fmt: skip
    caption = (
        f"The error{units} at which half of the gain over the image-only policy is left, on a "
        "curve that was made monotone, with 95 % interval from a bootstrap over pairs; “>” is "
        "beyond the largest error that was tried."
    )
    return Table(caption, head, rows)


def _halves(curve: ErrorCurve, axis: str) -> str:
    along = curve.along(axis)
    if curve.image_only is None or not curve.image_only.rows or len(along) < 2:
        return NONE
    levels = [(error, arm.rows) for error, arm in along.items()]
    return str(halving_error(levels, curve.image_only.rows))


def _names(curves: Sequence[ErrorCurve]) -> list[str]:
    more = [c.clean.label("pose_noise", "pose_noise_per", "conditioning") for c in curves]
    return tell_apart([c.name for c in curves], more)


@styled
def over_errors(curves: Sequence[ErrorCurve]) -> Figure:
    """Success over the error: a column for each axis, a row for each task and policy.

    Args:
        curves: Of one kind of error.
    """
    lines: dict[tuple[str, str], list[ErrorCurve]] = {}
    for curve in curves:
        s = curve.clean.settings
        lines.setdefault((paper.task_title(s["task"]), s["policy"]), []).append(curve)
    names = {line: _names(some) for line, some in lines.items()}
    looks = distinct({
        name: (colour_of(curve.clean), _style(curve))
        for line, some in lines.items()
        for name, curve in zip(names[line], some, strict=True)
    })  # fmt: skip
    axes_of = [axis for axis in _AXES if any(len(c.along(axis)) > 1 for c in curves)]
    size = (3.8 * len(axes_of), 0.6 + 3.1 * len(lines))
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(len(lines), len(axes_of), squeeze=False, sharey=True)
    for row, (line, some) in zip(grid, lines.items(), strict=True):
        for axes, axis in zip(row, axes_of, strict=True):
            for name, curve in zip(names[line], some, strict=True):
                _line(axes, curve, axis, looks[name])
            axes.set(ylim=(0, 1), xlabel=_AXES[axis])
            axes.yaxis.set_major_formatter(percent())
        row[0].set_title(drawn(f"{line[0]}, {paper.policy_title(line[1])}"))
    handles = {name: Line2D([], [], **look) for name, look in looks.items()}
    if any(curve.image_only for curve in curves):
        handles["image only"] = Line2D([], [], color=GREY, linestyle=":")
    legend_below(figure, handles)
    return figure


def _line(axes: Axes, curve: ErrorCurve, axis: str, look: Mapping[str, Any]) -> None:
    along = curve.along(axis)
    if len(along) < 2:
        return
    band(axes, [*along], [arm.estimate for arm in along.values()], **look)
    if curve.image_only:
        e = curve.image_only.estimate
        axes.axhline(e.value, color=GREY, linestyle=":")
        axes.axhspan(e.low, e.high, color=GREY, alpha=0.07, linewidth=0)


def _style(curve: ErrorCurve) -> Literal["--", "-"]:
    return "--" if curve.clean.settings.get("pose_noise") else "-"


@styled
def error_maps(curves: Sequence[ErrorCurve]) -> Figure:
    """Success by rotation and translation, a panel for each policy.

    Args:
        curves: Of one kind of error.
    """
    figure, grid = panel_grid(len(curves), (3.4, 3.2))
    for axes, curve in zip(grid, curves, strict=True):
        degrees, cm = (sorted({at[i] for at in curve.arms}) for i in (0, 1))
        for (d, c), arm in curve.arms.items():
            x, y, e = degrees.index(d), cm.index(c), arm.estimate
            axes.fill_between([x, x + 1], y, y + 1, color=RATE(e.value), linewidth=0)
            words = f"{100 * e.value:.0f}\n[{100 * e.low:.0f}, {100 * e.high:.0f}]"
            ink: Any = "white" if abs(e.value - 0.5) > 0.35 else INK
            axes.text(x + 0.5, y + 0.5, words, ha="center", va="center", fontsize=6.5, color=ink)
        axes.set(xlabel=_AXES["rotation"], ylabel=_AXES["translation"],
                 xlim=(0, len(degrees)), ylim=(0, len(cm)))  # fmt: skip
        axes.set_xticks([i + 0.5 for i in range(len(degrees))], [f"{d:g}" for d in degrees])
        axes.set_yticks([i + 0.5 for i in range(len(cm))], [f"{c:g}" for c in cm])
        axes.grid(visible=False)
        axes.set_title(drawn(curve.name), fontsize=9)
    return figure
