"""Rows are read and written in one form, older ones are read too, and other things refused."""

import json

import pytest
from places import REPO

from jaxcam.errors import DatasetError
from jaxcam.results.rows import Row

# As version 0.1.0 wrote it, in this order.
LINE = {
    "task": "lift", "scene": "randomized", "run": "a", "policy": "act", "conditioning": "none",
    "seed": 0, "step": 4000, "split": "test", "pair": 3, "pair_sha": "18fce5afc053ec82",
    "success": False, "status": "ok", "steps": 150, "azimuth_deg": 3.114, "elevation_deg": 58.409,
    "distance": 1.083, "camera": [[[1.0] * 4] * 4], "renderer": "warp", "engine": "mjx",
    "ensemble": 0.1, "width": 50, "episode_seed": 1000003,
}  # fmt: skip


def test_a_row_is_written_as_it_was_read():
    written = Row.from_json(LINE).to_json()
    assert list(written.items()) == list(LINE.items())
    assert Row.from_json(LINE).to_json(["pair", "width"]) == {"pair": 3, "width": 50}


def test_rows_of_before_there_was_a_choice_have_what_was_usual_then():
    row = Row.from_json({"pair": 0, "status": "error", "success": None})
    assert (row.engine, row.ensemble, row.split, row.width) == ("native", 0.0, "test", None)
    assert not row.finished
    assert "width" not in row.to_json()


@pytest.mark.parametrize("name", ["lift-conditionings", "lift-randomized"])
def test_published_rows_are_read_as_they_are(name):
    lines = (REPO / "results" / name / "rows.jsonl").read_text("utf-8").splitlines()
    for line in map(json.loads, lines):
        written = Row.from_json(line).to_json()
        assert {k: written.pop(k) for k in line} == line
        assert written == {"engine": "native", "ensemble": 0.0}


def test_names_that_are_not_known_are_left_out():
    assert Row.from_json({**LINE, "weather": "fine"}) == Row.from_json(LINE)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pair": None}, "there, line 1: pair is None, expected a whole number, 0 or more"),
        ({"pair": True}, "pair is True"),
        ({"success": 2}, "success is 2, expected true or false, or null"),
        ({"status": "fine"}, "status is 'fine', expected ok or policy or simulator or error"),
        ({"distance": float("nan")}, "distance is nan, expected a finite number, or null"),
        ({"width": "50"}, "width is '50', expected a whole number"),
        ({"camera": 1.0}, "camera is 1.0, expected a list"),
        ({"step": None}, "step is None"),
        ({"azimuth_deg": 1e18}, "azimuth_deg is 1e\\+18, expected at most 360"),
        ({"pair": 2**70}, "pair is 1180591620717411303424, expected a whole number"),
        ({"status": "policy", "success": True}, "success is true, but status is 'policy'"),
    ],
)
def test_a_value_of_another_kind_is_named(changes, message):
    with pytest.raises(DatasetError, match=message):
        Row.from_json({**LINE, **changes}, "there, line 1")


def test_what_is_no_row_is_refused():
    with pytest.raises(DatasetError, match="A row: pair is missing, expected a whole number"):
        Row.from_json({"status": "ok"})
    with pytest.raises(DatasetError, match=r"expected the fields of a rollout, got \[1\]"):
        Row.from_json([1])
