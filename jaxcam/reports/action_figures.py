"""Figures of a run that learned from recorded episodes: how far its actions are off."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from jaxcam.reports.run_figures import loss_curves
from jaxcam.reports.style import BLUE, VERMILION, save, side_by_side, styled
from jaxcam.results.actions import ActionErrors


def _label(row: ActionErrors) -> str:
    wrong = f", poses off by {row.rotation_deg:g}°, {100 * row.translation:g} cm"
    return row.group + (wrong if row.rotation_deg or row.translation else "")


@styled
def errors_by_horizon(rows: Sequence[ActionErrors]) -> Figure:
    """Mean error, in deviations of the actions, over the steps of a chunk.

    Args:
        rows: Of one checkpoint.
    """
    figure, (axes,) = side_by_side((6.4, 3.5))
    colours = {"new episodes": BLUE, "new cameras": VERMILION}
    for row in rows:
        by_step = np.nanmean(row.relative, (0, 2))
        wrong = bool(row.rotation_deg or row.translation)
        axes.plot(
            np.arange(1, len(by_step) + 1), by_step, label=_label(row),
            color=colours.get(row.group, BLUE), linestyle="--" if wrong else "-",
        )  # fmt: skip
    axes.axhline(1, color="0.6", linewidth=0.8)
    axes.set_xlabel("step of the chunk")
    axes.set_ylabel("error (deviations)")
    axes.set_ylim(bottom=0)
    axes.legend(fontsize=7)
    return figure


@styled
def errors_by_number(rows: Sequence[ActionErrors]) -> Figure:
    """Mean error of each number of an action, in its own deviation.

    Args:
        rows: Of one checkpoint.
    """
    names = rows[0].names
    figure, (axes,) = side_by_side((6.4, max(2.2, 0.28 * len(names) + 1)))
    right = [row for row in rows if not (row.rotation_deg or row.translation)]
    height = 0.8 / len(right)
    colours = {"new episodes": BLUE, "new cameras": VERMILION}
    for place, row in enumerate(right):
        at = np.arange(len(names)) + (place - (len(right) - 1) / 2) * height
        axes.barh(at, np.nanmean(row.relative, (0, 1)), height, label=row.group,
                  color=colours.get(row.group, BLUE))  # fmt: skip
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.axvline(1, color="0.6", linewidth=0.8)
    axes.set_xlabel("error (deviations)")
    axes.legend(fontsize=7)
    return figure


def write_action_figures(
    folder: Path, metrics: Iterable[Mapping[str, Any]], rows: Sequence[ActionErrors]
) -> None:
    """Draw the figures of a run into a folder.

    Args:
        folder: Where PNG files are written.
        metrics: Of the run.
        rows: Errors of one checkpoint; none leaves their figures out.
    """
    save(loss_curves(metrics), folder / "loss.png")
    if rows:
        save(errors_by_horizon(rows), folder / "errors_by_horizon.png")
        save(errors_by_number(rows), folder / "errors_by_number.png")
