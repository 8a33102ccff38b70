"""Figures leave matplotlib as they found it, and their legends fit."""

import subprocess
import sys

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxcam.reports.style import distinct, legend_below, tell_apart


def test_figures_need_no_pyplot_and_change_no_settings():
    code = (
        "import sys, matplotlib as mpl; before = mpl.rcParams.copy()\n"
        "from jaxcam.reports import run_figures as plots\n"
        "plots.loss_curves([{'step': 1, 'loss': 1.0}])\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
        "assert mpl.rcParams.copy() == before\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")


def test_a_legend_is_never_wider_than_its_figure():
    """Six policies over fields of view had one that was cut off on both sides."""
    figure = Figure(figsize=(4.8, 3.6), layout="constrained")
    figure.subplots()
    names = ("keypoints", "keypoints, extrinsics only", "late", "late, extrinsics only",
             "twin of keypoints", "twin of late")  # fmt: skip
    legend_below(figure, {name: Line2D([], []) for name in names})
    (legend,) = figure.legends
    assert legend.get_window_extent().width <= figure.bbox.width
    assert [text.get_text() for text in legend.get_texts()] == [*names]


def test_curves_that_would_look_alike_have_markers_of_their_own():
    """Three policies trained with errors were three lines of one green dash in the legend."""
    looks = {"a": ("green", "--"), "b": ("green", "-"), "c": ("green", "--"), "d": ("blue", "--")}
    drawn = distinct(looks)
    assert {name: (x["color"], x["linestyle"]) for name, x in drawn.items()} == looks
    assert [drawn[name]["marker"] for name in "abd"] == ["o"] * 3
    assert drawn["c"]["marker"] != "o"


def test_many_curves_that_would_look_alike_are_drawn_unlike():
    drawn = distinct({str(i): ("green", "--") for i in range(12)})
    looks = {(x["marker"], x.get("markerfacecolor")) for x in drawn.values()}
    assert len(looks) == 12


def test_a_high_legend_leaves_the_panel_its_room():
    figure = Figure(figsize=(4.8, 3.6), layout="constrained")
    axes = figure.subplots()
    legend_below(figure, {f"a policy with a long name, trained with {i}": Line2D([], [])
                          for i in range(30)})  # fmt: skip
    figure.draw_without_rendering()
    (legend,) = figure.legends
    assert axes.get_window_extent().height > 2 * figure.dpi
    assert legend.get_window_extent().y1 < axes.get_window_extent().y0


def test_names_of_several_curves_have_more_said_of_them():
    assert tell_apart(["late", "keypoints", "late"], ["x", "y", "z"]) == [
        "late, x", "keypoints", "late, z",
    ]  # fmt: skip
