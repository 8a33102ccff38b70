"""Success over the field of view: in bins that keep inside and outside apart."""

import numpy as np
import pytest
from made_runs import arms_of, make_run
from run_rows import evaluation

from jaxcam.reports.axes.fovy import fovy_blocks, fovy_curves

COUNT = 100
TWIN = {"late": {}, "none": {"model": ("twin_of=late",)}}


@pytest.fixture
def runs(tmp_path):
    """Cameras of 25 to 75 degrees; who is told poses alone fails outside of 35 to 55."""
    fovy = np.linspace(25, 75, COUNT)
    fovy[[20, 60]] = 35, 55  # on the ends of the training's range
    for way, rays, wins in (
        ("late", "true", fovy > 0),
        ("late", "nominal", (fovy >= 35) & (fovy <= 55)),
        ("none", "true", fovy < 0),
    ):
        name = f"{way}-{rays}"
        rows = evaluation(wins, conditioning=way, policy="act", scene="randomized", step=4000,
                          run=name, eval_fovy="25:75")  # fmt: skip
        rows = [row.to_json() | {"fovy_deg": angle, "pair_sha": f"{row.pair:016x}"}
                for row, angle in zip(rows, fovy, strict=True)]  # fmt: skip
        make_run(tmp_path / name, conditioning=way, rays_from=rays, fovy="35:55",
                 eval_fovy="25:75", pairs=0, rows=rows, **TWIN[way])  # fmt: skip
    return tmp_path


def test_inside_and_outside_are_told_apart(runs):
    (panel,) = fovy_curves(arms_of(runs))
    by_name = {curve.name: curve for curve in panel}
    assert set(by_name) == {"late", "late, extrinsics only", "twin of late"}
    alone = by_name["late, extrinsics only"]
    assert alone.trained == (35, 55)
    assert alone.within(*alone.trained).value == 1
    assert alone.outside().value == 0
    assert [e.value for _, e in alone.bins()] == [0, 1, 1, 0, 0]
    assert [round(x) for x, _ in alone.bins()] == [30, 40, 50, 60, 70]
    assert sum(e.n for _, e in alone.bins()) == COUNT


def test_the_report_has_figure_and_differences(runs, tmp_path):
    _, _, table = fovy_blocks(arms_of(runs), tmp_path / "out")
    lines = {row[2]: row for row in table.rows}
    assert lines["late, extrinsics only"][6].startswith("+100.0 [")
    assert lines["late"][6].startswith("+0.0 [")
    assert (tmp_path / "out/figures/fovy.png").is_file()


def test_without_a_range_nothing_is_said(tmp_path):
    make_run(tmp_path / "late", conditioning="late")
    assert fovy_blocks(arms_of(tmp_path), tmp_path) == []
