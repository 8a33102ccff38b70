"""Success over the number of cameras and of demonstrations, with the law that both follow."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxcam.reports import paper
from jaxcam.reports.arms import Arm, context
from jaxcam.reports.document import Block, Heading, Picture, Table
from jaxcam.reports.names import drawn
from jaxcam.reports.study_figures import panel_grid
from jaxcam.reports.style import band, percent, save, styled
from jaxcam.reports.tables import by_task
from jaxcam.results.scaling import Counts, ScalingLaw, scaling_law


@dataclass(frozen=True)
class ScalingSurface:
    """One policy, trained with several numbers of cameras and of demonstrations."""

    arms: Mapping[Counts, Arm]
    """By the numbers of cameras and of demonstrations, ascending."""
    law: ScalingLaw

    @property
    def some(self) -> Arm:
        """One of its arms, for what they share."""
        return next(iter(self.arms.values()))


def surfaces(arms: Sequence[Arm]) -> list[ScalingSurface]:
    """Every policy of which enough cells are there, all cameras seen by every demonstration.

    Args:
        arms: All there are.
    """
    groups: dict[str, dict[Counts, Arm]] = {}
    known = [
        a for a in arms
        if a.estimate.n and not a.is_told_wrong and a.settings.get("m") == 0
        and a.settings.get("demos") and a.settings.get("n")
    ]  # fmt: skip
    for some in by_task(known).values():
        for arm in some:
            at = float(arm.settings["n"]), float(arm.settings["demos"])
            groups.setdefault(context(arm, "n", "demos"), {})[at] = arm
    fitted = []
    for cells in groups.values():
        ordered = dict(sorted(cells.items()))
        if law := scaling_law({at: arm.rows for at, arm in ordered.items()}):
            fitted.append(ScalingSurface(ordered, law))
    return fitted


def scaling_blocks(arms: Sequence[Arm], out: Path) -> list[Block]:
    """What a report says of cameras and demonstrations; nothing where both were not varied.

    Args:
        arms: All there are.
        out: Folder of the report.
    """
    shown = surfaces(arms)
    if not shown:
        return []
    save(over_cameras(shown), out / "figures" / "scaling.png")
    caption = (
        "Success over the number of cameras, by the number of demonstrations, with 95 % intervals "
        "over pairs; dashed: the law. All demonstrations are seen by all cameras."
    )
    head = ("Policy", "Task", "Conditioning", "Settings", "Exponent of cameras",
            "Exponent of demonstrations", "Odds of failure that stay", "Error on cells left out",
            "By chance alone", "Cells, pairs")  # fmt: skip
    words = (
        "Odds of failure = floor + a · cameras^-alpha + b · demonstrations^-beta, fitted to the "
        "successes, with 95 % intervals from a bootstrap over pairs. The error (points, mean of "
        "absolute differences) is of cells that were predicted from the others; beside it, what a "
        "law that holds would have by the number of pairs. A dash: the successes do not tell that "
        "this number matters, and the law does without it."
    )
    return [Heading("Cameras and demonstrations"), Picture("figures/scaling.png", caption),
            Table(words, head, [_line_of(surface) for surface in shown])]  # fmt: skip


def _line_of(surface: ScalingSurface) -> list[str]:
    s, law = surface.some.settings, surface.law
    return [
        paper.policy_title(s["policy"]), paper.task_title(s["task"]), surface.some.way,
        surface.some.label("n", "demos"), str(law.alpha or "–"), str(law.beta or "–"),
        str(law.floor),
        f"{100 * law.error:.1f}", f"{100 * law.by_chance:.1f}", f"{len(law.cells)}, {law.pairs}",
    ]  # fmt: skip


@styled
def over_cameras(shown: Sequence[ScalingSurface]) -> Figure:
    """Success over the number of cameras, a panel for each policy.

    Args:
        shown: From `surfaces`.
    """
    figure, grid = panel_grid(len(shown), (4.2, 3.4))
    for axes, surface in zip(grid, shown, strict=True):
        counts = sorted({demos for _, demos in surface.arms})
        for share, demos in zip(np.linspace(0.15, 0.8, len(counts)), counts, strict=True):
            _draw(axes, surface, demos, colormaps["viridis"](share))
        s = surface.some.settings
        policy, task = paper.policy_title(s["policy"]), paper.task_title(s["task"])
        axes.set_title(drawn(f"{task}, {policy}, {surface.some.way}"))
        axes.set(ylim=(0, 1), xscale="log", xlabel="cameras")
        axes.yaxis.set_major_formatter(percent())
        axes.legend(title="demonstrations", fontsize=8)
    return figure


def _draw(axes: Axes, surface: ScalingSurface, demos: float, colour: tuple[float, ...]) -> None:
    arms = {n: arm for (n, count), arm in surface.arms.items() if count == demos}
    estimates = [arm.estimate for arm in arms.values()]
    band(axes, [*arms], estimates, color=colour, linestyle="", marker="o", label=f"{demos:g}")
    cameras = np.geomspace(min(arms), max(arms), 60)
    axes.plot(cameras, surface.law.at(cameras, demos), "--", color=colour)
