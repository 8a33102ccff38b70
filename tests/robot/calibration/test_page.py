"""The page of a calibration, and the drawings on it."""

import numpy as np
import pytest
from seen_boards import optics
from web_page import Page

from jaxcam.errors import ConfigError
from jaxcam.robot.calibration.figures import residual_figure, space_figure
from jaxcam.robot.calibration.page import (
    AWAY,
    SEEN,
    CalibrationPage,
    overlay,
    page_path,
    spread_out,
    write_calibration,
)


def test_a_page_has_its_verdict_and_may_be_written_again(tmp_path):
    rng = np.random.default_rng(0)
    figures = {
        "residuals": residual_figure(
            rng.uniform(0, 480, (20, 2)), rng.normal(0, 0.1, (20, 2)), np.arange(20) > 1, (640, 480)
        ),
        "space": space_figure(
            {"front": [np.eye(4)]}, {"front": optics()}, {"tag": np.eye(4)[None, :, :3]}
        ),
    }  # fmt: skip
    page = CalibrationPage("A <b>", "sub", "Not good enough: 3 mm.", False, [("x", "1", "2")],
                           notes=["look"], figures=figures)  # fmt: skip
    path = page_path("", tmp_path / "cameras.json", "tags", "front/left")
    assert path.name == "tags-front-left.html"
    for _ in range(2):
        shown = Page(write_calibration(page, path))
        assert "Not good enough: 3 mm." in shown.text
        assert "A <b>" in shown.text
        assert page_path(str(path), tmp_path / "cameras.json", "tags", "") == path
    path.write_text("mine")
    with pytest.raises(ConfigError, match="jaxcam did not write it"):
        page_path(str(path), tmp_path / "cameras.json", "tags", "")
    with pytest.raises(ConfigError, match=r"ends in \.html"):
        page_path("a.png", tmp_path / "cameras.json", "tags", "")


def test_rings_are_around_what_was_seen():
    picture = overlay(
        np.zeros((48, 64, 3), np.uint8), np.array([[20.5, 10.5], [40.5, 30.5]]),
        np.array([[20.5, 10.5], [40.5, 30.5]]), np.array([True, False]),
    )  # fmt: skip
    scale = picture.shape[1] // 64
    for (u, v), colour in (((20.5, 10.5), SEEN), ((40.5, 30.5), AWAY)):
        rows, columns = np.nonzero((np.abs(picture.astype(int) - colour) < 30).all(-1))
        assert np.abs([columns.mean() - u * scale, rows.mean() - v * scale]).max() < 2


def test_spread_out():
    assert spread_out(3) == [0, 1, 2]
    assert spread_out(11, 3) == [0, 5, 10]
