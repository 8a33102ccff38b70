"""The figures of a run.

Every function takes rows or arrays and returns a matplotlib `Figure`; `save` writes PNG or SVG.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from jaxcam.reports.camera_figures import rate_by_camera, success_map
from jaxcam.reports.style import (
    BLUE,
    VERMILION,
    percent,
    save,
    side_by_side,
    small_print,
    styled,
)
from jaxcam.results.actions import OF_MEAN, ActionErrors
from jaxcam.results.rows import Row


@styled
def loss_curves(metrics: Iterable[Mapping[str, Any]]) -> Figure:
    """Training loss (each logged value and its running mean) and validation loss over steps.

    Args:
        metrics: Rows with "step" and any of "loss", "val_loss"; others are ignored.

    Returns:
        The figure.
    """
    metrics = list(metrics)
    figure, (axes,) = side_by_side((6.4, 3.5))
    steps, losses = _series(metrics, "loss")
    if len(steps):
        if len(steps) > 20:
            axes.plot(steps, losses, color=BLUE, alpha=0.22, linewidth=0.8)
            losses = _running_mean(losses, max(len(losses) // 50, 3))
        axes.plot(steps, losses, color=BLUE, label="training")
    val_steps, val_losses = _series(metrics, "val_loss")
    if len(val_steps):
        axes.plot(
            val_steps, val_losses, color=VERMILION, marker="o", markersize=4, label="validation"
        )
    values = np.concatenate([losses, val_losses])
    if len(values) and values.min() > 0 and values.max() > 8 * values.min():
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set(title="Loss", xlabel="training step")
    _step_axis(axes, max([*steps, *val_steps], default=1))
    if len(values):
        axes.legend()
    return figure


@styled
def success_curve(metrics: Iterable[Mapping[str, Any]]) -> Figure:
    """Success on held-out pairs over training steps, with the 95 % interval as a band.

    Args:
        metrics: Rows with "step", "success_rate", "low", "high", "pairs"; others are ignored.

    Returns:
        The figure.
    """
    rows = sorted((r for r in metrics if "success_rate" in r), key=lambda r: r["step"])
    figure, (axes,) = side_by_side((6.4, 3.5))
    axes.set(title="Success on held-out cameras", xlabel="training step", ylim=(0, 1))
    axes.yaxis.set_major_formatter(percent())
    if rows:
        steps, rates, low, high = (
            np.array([row[name] for row in rows], float)
            for name in ("step", "success_rate", "low", "high")
        )
        if len(rows) > 1:
            axes.fill_between(steps, low, high, color=BLUE, alpha=0.16, linewidth=0)
        else:
            axes.errorbar(steps, rates, [rates - low, high - rates], color=BLUE, capsize=4)
        axes.plot(steps, rates, color=BLUE, marker="o", markersize=5)
        axes.annotate(
            f"{100 * rates[-1]:.0f} %", (steps[-1], rates[-1]), (-8, 7),
            textcoords="offset points", ha="right", color=BLUE, weight="bold",
        )  # fmt: skip
        pairs = sorted({int(row["pairs"]) for row in rows if "pairs" in row})
        counts = " to ".join(str(n) for n in dict.fromkeys([*pairs[:1], *pairs[-1:]]))
        small_print(axes, f"95 % interval, {counts} pairs" if pairs else "95 % interval")
    _step_axis(axes, rows[-1]["step"] if rows else 1)
    return figure


def write_plots(
    folder: str | Path, metrics: Sequence[Mapping[str, Any]], rows: Sequence[Row]
) -> list[Path]:
    """Draw the figures of one run that its rows allow: loss, success, success over the sphere.

    Args:
        folder: Where loss.png, success.png and success_map.png go.
        metrics: Rows of metrics.jsonl.
        rows: Evaluation rows of the checkpoint to show.

    Returns:
        The files written.
    """
    folder = Path(folder)
    written: list[Path] = []
    if any("loss" in row for row in metrics):
        written.append(save(loss_curves(metrics), folder / "loss.png"))
    if any("success_rate" in row for row in metrics):
        written.append(save(success_curve(metrics), folder / "success.png"))
    if len(rate_by_camera(rows)):
        written.append(save(success_map(rows), folder / "success_map.png"))
    return written


def _series(metrics: Sequence[Mapping[str, Any]], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Steps and finite values of one metric."""
    points = [(row["step"], row[name]) for row in metrics if row.get(name) is not None]
    table = np.array(points, float).reshape(-1, 2)
    table = table[np.isfinite(table[:, 1])]
    return table[:, 0], table[:, 1]


def _running_mean(values: np.ndarray, width: int) -> np.ndarray:
    """Centred mean over `width` values, over fewer at the ends."""
    window = np.ones(width)
    return np.convolve(values, window, "same") / np.convolve(np.ones_like(values), window, "same")


def _step_axis(axes: Axes, last: float) -> None:
    axes.set_xlim(0, last * 1.04)
    axes.xaxis.set_major_locator(MaxNLocator(7, integer=True, steps=[1, 2, 2.5, 5, 10]))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))


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
        steps = np.flatnonzero(np.isfinite(row.relative).any((0, 2)))  # that an episode reaches
        by_step = np.nanmean(row.relative[:, steps], (0, 2))
        wrong = bool(row.rotation_deg or row.translation)
        axes.plot(
            steps + 1, by_step, label=_label(row),
            color=colours.get(row.group, BLUE), linestyle="--" if wrong else "-",
        )  # fmt: skip
    axes.axhline(OF_MEAN, color="0.6", linewidth=0.8)
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
    axes.set_yticks(range(len(names)), names, parse_math=False)  # a dollar is a dollar
    axes.invert_yaxis()
    axes.axvline(OF_MEAN, color="0.6", linewidth=0.8)
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
