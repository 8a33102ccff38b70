"""Figures of many runs show the numbers of their arms."""

import pytest
from made_runs import BY_FIELD, arms_of, make_studies
from matplotlib.colors import to_hex

from jaxcam.reports.studies import panels
from jaxcam.reports.study_figures import COLOURS, bars, curves


def test_bars_and_curves_show_the_rates(tmp_path):
    make_studies(tmp_path)
    arms = arms_of(tmp_path)
    (scene,), (cameras,) = (panels(BY_FIELD[name], arms) for name in ("scene", "n"))
    axes = curves([cameras], "cameras").axes[0]
    assert axes.get_xscale() == "log"
    assert [t.get_text() for t in axes.get_xticklabels()] == ["3", "30"]
    figure = bars([scene], BY_FIELD["scene"].names)
    drawn = figure.axes[0].patches
    assert [to_hex(b.get_facecolor()) for b in drawn] == [COLOURS["none"].lower(),
                                                         COLOURS["late"].lower()] * 2  # fmt: skip
    assert all(b.get_hatch() for b in drawn)  # none has all rollouts of the protocol
    assert all(b.get_height() == 0.5 for b in drawn)
    figure.draw_without_rendering()
    (legend,) = figure.legends
    assert figure.bbox.x0 <= legend.get_window_extent().x0
    assert legend.get_window_extent().x1 <= figure.bbox.x1


@pytest.mark.parametrize("long", ["about the table there", "eef_delta_componentwise"])
def test_names_of_neighbours_do_not_touch(tmp_path, long):
    make_studies(tmp_path)
    (scene,) = panels(BY_FIELD["scene"], arms_of(tmp_path))
    figure = bars([scene], dict.fromkeys(("fixed", "randomized"), long))
    figure.draw_without_rendering()
    left, right = figure.axes[0].get_xticklabels()
    rotated = {label.get_rotation() for label in (left, right)} == {20.0}
    assert rotated == ("_" in long)
    if rotated:
        assert left.get_text() == long
    else:
        assert left.get_text().split() == long.split()
        assert left.get_window_extent().x1 < right.get_window_extent().x0


def test_a_name_without_spaces_leaves_the_bars_their_room(tmp_path):
    make_studies(tmp_path)
    (scene,) = panels(BY_FIELD["scene"], arms_of(tmp_path))
    long = "act_lift_randomized_keypoints_step6000_ema_2026-12-01"
    for rows in (1, 2):
        figure = bars([scene] * (3 * rows), {"fixed": long, "randomized": "fixed " * 12})
        figure.draw_without_rendering()
        axes = figure.axes[0]
        assert axes.get_window_extent().height > 1.6 * figure.dpi
        assert all(label.get_window_extent().x0 > 0 for label in axes.get_xticklabels())
