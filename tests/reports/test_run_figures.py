"""The curves of a run."""

import numpy as np
from run_rows import texts, training

from jaxcam.reports.camera_figures import success_map
from jaxcam.reports.run_figures import (
    errors_by_horizon,
    errors_by_number,
    loss_curves,
    success_curve,
    write_plots,
)
from jaxcam.reports.style import save
from jaxcam.results.actions import ActionErrors


def test_curves_show_what_was_logged(tmp_path):
    (axes,) = loss_curves(training()).axes
    assert axes.get_yscale() == "log"
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["training", "validation"]
    (axes,) = success_curve(training()).axes
    assert "40 %" in texts(axes)
    for figure in (loss_curves([]), success_curve([]), success_map([])):
        save(figure, tmp_path / "empty.svg")
    assert (tmp_path / "empty.svg").read_text().startswith("<?xml")
    assert write_plots(tmp_path, [], []) == []


def test_errors_of_episodes_that_are_shorter_than_a_chunk(tmp_path):
    errors = np.full((2, 5, 2), np.nan)
    errors[0, :1], errors[1, :3] = 1, 2
    row = ActionErrors(1, "new episodes", 0.0, 0.0, ("x", r"$\no$ number_2"), np.ones(2), errors)
    (axes,) = errors_by_horizon([row]).axes
    np.testing.assert_array_equal(axes.lines[0].get_xydata(), [[1, 1.5], [2, 2], [3, 2]])
    by_number = errors_by_number([row])
    assert [text.get_text() for text in by_number.axes[0].get_yticklabels()] == list(row.names)
    save(by_number, tmp_path / "by_number.png")
    assert (tmp_path / "by_number.png").stat().st_size > 0
