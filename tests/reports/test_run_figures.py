"""The curves of a run."""

from run_rows import texts, training

from jaxcam.reports.camera_figures import success_map
from jaxcam.reports.run_figures import loss_curves, success_curve, write_plots
from jaxcam.reports.style import save


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
