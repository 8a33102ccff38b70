"""Success over the numbers of cameras and demonstrations: which runs are put together."""

import itertools

import pytest
from made_runs import arms_of, make_run

from jaxcam.reports.axes.scaling import scaling_blocks, surfaces


@pytest.fixture
def runs(tmp_path):
    """Late fusion in six cells, better with more of either; keypoints in too few."""
    for (i, n), (j, demos) in itertools.product(enumerate((3, 30, 300)), enumerate((50, 200))):
        for way in ("late", *(["keypoints"] if demos == 50 else [])):
            make_run(tmp_path / f"{way}-{n}-{demos}", conditioning=way, n=n, m=0, demos=demos,
                     rate=0.1 + 0.3 * i + 0.1 * j, pairs=40)  # fmt: skip
    make_run(tmp_path / "usual", conditioning="late", rate=0.9)  # m is 1: not of these
    return tmp_path


def test_a_policy_has_a_surface_where_both_were_varied(runs):
    (surface,) = surfaces(arms_of(runs))
    assert [*surface.arms] == [(3, 50), (3, 200), (30, 50), (30, 200), (300, 50), (300, 200)]
    assert surface.some.way == "late"
    assert surface.law.pairs == 40
    assert surface.law.alpha.value > 0.1
    assert (surface.law.at(300, 200) > surface.law.at(3, 50) + 0.4).all()


def test_the_report_has_the_law_and_its_error(runs, tmp_path):
    _, picture, table = scaling_blocks(arms_of(runs), tmp_path / "out")
    ((*_, error, chance, counts),) = table.rows
    assert float(error) < 20
    assert float(chance) > 1
    assert counts == "6, 40"
    assert (tmp_path / "out" / picture.path).is_file()


def test_rows_that_do_not_say_their_demonstrations_are_of_no_law(runs):
    arms = arms_of(runs)
    for arm in arms:
        arm.settings.pop("demos", None)
    assert surfaces(arms) == []


def test_without_both_nothing_is_said(tmp_path):
    make_run(tmp_path / "late", conditioning="late", n=3, m=0)
    assert scaling_blocks(arms_of(tmp_path), tmp_path) == []
