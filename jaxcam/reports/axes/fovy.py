"""Success over the field of view, inside and outside the range of the training."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxcam.config.conditions import FOVY, Span, span
from jaxcam.reports import paper
from jaxcam.reports.arms import Arm, context
from jaxcam.reports.document import Block, Heading, Picture, Table
from jaxcam.reports.names import drawn
from jaxcam.reports.study_figures import colour_of, panel_grid
from jaxcam.reports.style import (
    FAINT,
    band,
    distinct,
    legend_below,
    percent,
    save,
    styled,
    tell_apart,
)
from jaxcam.reports.tables import by_task
from jaxcam.results.rows import Row
from jaxcam.results.stats import Estimate, gap_between, success_rate
from jaxcam.sim import make_task

_WIDEST_BIN = 10.0
"""Degrees of field of view that rows are put together over, at most."""


@dataclass(frozen=True)
class FovyCurve:
    """One policy over fields of view.

    Attributes:
        arm: All its rollouts.
        trained: The range of its training (degrees).
    """

    arm: Arm
    trained: Span

    @property
    def name(self) -> str:
        """What tells it from others of its panel."""
        nominal = self.arm.setting("rays_from") == "nominal"
        return f"{self.arm.way}, extrinsics only" if nominal else self.arm.way

    @property
    def rows(self) -> list[Row]:
        """Those whose field of view is known."""
        return [row for row in self.arm.rows if row.fovy_deg is not None]

    def within(self, low: float, high: float) -> Estimate:
        """Success where the field of view is in a range.

        Args:
            low: Its least (degrees).
            high: Its largest.
        """
        return success_rate(r for r in self.rows if low <= (r.fovy_deg or 0.0) <= high)

    def bins(self) -> list[tuple[float, Estimate]]:
        """Success in bins, by their middle; none straddles an end of the range of the training."""
        known = [row.fovy_deg or 0.0 for row in self.rows]
        ends = [min(known), *(x for x in self.trained if min(known) < x < max(known)), max(known)]
        edges: list[float] = []
        for low, high in itertools.pairwise(ends):
            count = max(1, round((high - low) / _WIDEST_BIN))
            edges += np.linspace(low, high, count + 1).tolist()[:-1]
        edges.append(ends[-1])
        # What is on an edge is above it, but on the training's upper end, which is inside.
        cuts = [np.nextafter(x, np.inf) if x == self.trained[1] else x for x in edges]
        numbers = np.searchsorted(cuts, known, side="right").clip(1, len(edges) - 1) - 1
        some = [
            ((a + b) / 2, success_rate(self.rows[i] for i in np.flatnonzero(numbers == number)))
            for number, (a, b) in enumerate(itertools.pairwise(edges))
        ]
        return [(middle, estimate) for middle, estimate in some if estimate.n]

    def outside(self) -> Estimate:
        """Success outside the training's range."""
        low, high = self.trained
        return success_rate(r for r in self.rows if not low <= (r.fovy_deg or 0.0) <= high)


def fovy_curves(arms: Sequence[Arm]) -> list[list[FovyCurve]]:
    """The policies that were evaluated on a range of fields of view, by what they share.

    Args:
        arms: All there are.
    """
    groups: dict[str, list[FovyCurve]] = {}
    for some in by_task(arm for arm in arms if arm.settings.get("eval_fovy")).values():
        for arm in some:
            if len({row.fovy_deg for row in arm.rows}) < 2:
                continue
            usual = make_task(arm.settings["task"]).fovy_deg
            trained = span(arm.settings.get("fovy", ""), "fovy", FOVY) or (usual, usual)
            key = context(arm, "conditioning", "rays_from")
            groups.setdefault(key, []).append(FovyCurve(arm, trained))
    return [*groups.values()]


def fovy_blocks(arms: Sequence[Arm], out: Path) -> list[Block]:
    """What a report says of fields of view; nothing where they were not varied.

    Args:
        arms: All there are.
        out: Folder of the report.
    """
    panels = fovy_curves(arms)
    if not panels:
        return []
    save(over_fovy(panels), out / "figures" / "fovy.png")
    caption = (
        "Success over the vertical field of view, in bins with 95 % intervals over pairs; grey: "
        "the range of the training."
    )
    rows = [_line_of(curve) for panel in panels for curve in panel]
    head = ("Policy", "Task", "Told", "Settings", "Inside", "Outside", "Inside minus outside",
            "Rollouts")  # fmt: skip
    words = (
        "Success in percent inside and outside the training's range of fields of view; these are "
        "other pairs, so differences (points, Newcombe's interval) are not paired."
    )
    return [Heading("Fields of view"), Picture("figures/fovy.png", caption),
            Table(words, head, rows)]  # fmt: skip


def _line_of(curve: FovyCurve) -> list[str]:
    s, inside, outside = curve.arm.settings, curve.within(*curve.trained), curve.outside()
    value, low, high = (100 * x for x in gap_between(inside, outside))
    gap = f"{value:+.1f} [{low:+.1f}, {high:+.1f}]" if inside.n and outside.n else "–"
    rates = [
        f"{100 * e.value:.1f} [{100 * e.low:.1f}, {100 * e.high:.1f}]" if e.n else "–"
        for e in (inside, outside)
    ]
    return [
        paper.policy_title(s["policy"]), paper.task_title(s["task"]), curve.name,
        curve.arm.label("rays_from"), *rates, gap, f"{inside.n}, {outside.n}",
    ]  # fmt: skip


@styled
def over_fovy(panels: Sequence[Sequence[FovyCurve]]) -> Figure:
    """Success over the field of view, a panel for each task and policy.

    Args:
        panels: From `fovy_curves`.
    """
    figure, grid = panel_grid(len(panels), (4.8, 3.6))
    names = [tell_apart([c.name for c in some], [c.arm.label("rays_from") for c in some])
             for some in panels]  # fmt: skip
    looks = distinct({
        name: (colour_of(curve.arm), _style(curve))
        for own, some in zip(names, panels, strict=True)
        for name, curve in zip(own, some, strict=True)
    })  # fmt: skip
    for axes, own, panel in zip(grid, names, panels, strict=True):
        for trained in {curve.trained for curve in panel}:
            axes.axvspan(*trained, color=FAINT, zorder=0)
        for name, curve in zip(own, panel, strict=True):
            middles, estimates = zip(*curve.bins(), strict=True)
            band(axes, middles, estimates, **looks[name])
        s = panel[0].arm.settings
        axes.set_title(drawn(f"{paper.task_title(s['task'])}, {paper.policy_title(s['policy'])}"))
        axes.set(ylim=(0, 1), xlabel="vertical field of view (degrees)")
        axes.yaxis.set_major_formatter(percent())
    legend_below(figure, {name: Line2D([], [], **look) for name, look in looks.items()})
    return figure


def _style(curve: FovyCurve) -> Literal["--", "-"]:
    return "--" if curve.arm.settings.get("rays_from") == "nominal" else "-"
