"""`runs.json` is what was written, or refused with a word."""

import json

import pytest
from places import REPO

from jaxcam.errors import DatasetError
from jaxcam.reports.packs.folder import read_results
from jaxcam.reports.packs.records import NAMED, read_records

PUBLISHED = REPO / "results" / "lift"


@pytest.fixture
def file(tmp_path):
    records = json.loads((PUBLISHED / "runs.json").read_text("utf-8"))[:2]
    (tmp_path / "runs.json").write_text(json.dumps(records))
    return tmp_path / "runs.json"


def change(file, **values):
    records = json.loads(file.read_text())
    records[0] |= values
    file.write_text(json.dumps(records))


@pytest.mark.parametrize("name", ["lift", "push-randomized"])
def test_published_runs_are_read(name):
    runs = read_results(REPO / "results" / name, "test")
    assert all(run.rows for run in runs)


def test_results_from_before_a_setting_was_there_are_of_the_same_runs(file):
    """Settings that came later are said where they are not as usual, whoever wrote them down."""
    (before, _) = read_records(file)
    settings = before.settings | {"color_jitter": 0.0, "action_frame": "base", "ray_frame": "base"}
    change(file, settings=settings)
    assert read_records(file)[0] == before
    change(file, settings=settings | {"color_jitter": None})
    assert read_records(file)[0] == before
    change(file, settings=settings | {"color_jitter": 0.3})
    assert read_records(file)[0].settings == before.settings | {"color_jitter": 0.3}


@pytest.mark.parametrize(
    "content", ["", "{", "null", "3", "{}", '"x"', "[1]", "[null]", "[[]]", "[{}]", "NaN"]
)
def test_another_kind_of_content_is_refused(file, content):
    file.write_text(content)
    with pytest.raises(DatasetError, match=r"runs\.json"):
        read_records(file)


ODD = [None, -1, 1.5, True, "x", [], {}, 2**70, float("nan"), [[1]], {"a": 1}]


def read_or_refused(file):
    """The first record; None if it is refused, with a word about where."""
    try:
        return read_records(file)[0]
    except DatasetError as error:
        words = str(error)
    assert "runs.json, run 0: " in words or "two runs have one number" in words
    return None


@pytest.mark.parametrize("name", ["run", "name", "seed", "settings", "seconds"])
@pytest.mark.parametrize("value", ODD, ids=repr)
def test_an_odd_value_is_refused_or_read(file, name, value):
    change(file, **{name: value})
    record = read_or_refused(file)
    if isinstance(value, dict) and name == "settings":
        value = dict.fromkeys(NAMED, "not recorded") | value
    assert record is None or getattr(record, name) == value


SETTINGS = ("task", "policy", "conditioning", "preset", "steps", "n", "crop_min", "action_space",
            "model", "weights", "engine")  # fmt: skip


@pytest.mark.parametrize("name", SETTINGS)
@pytest.mark.parametrize("value", ODD, ids=repr)
def test_an_odd_setting_is_refused_or_read(file, name, value):
    settings = json.loads(file.read_text())[0]["settings"]
    change(file, settings=settings | {name: value})
    record = read_or_refused(file)
    assert record is None or record.settings[name] == value


@pytest.mark.parametrize(
    ("name", "value", "fits"),
    [("pose_noise", ["1,1"], False), ("pose_noise", [], False), ("steps", ["5"], False),
     ("model", ["width=16"], True), ("model", [16], False)],
)  # fmt: skip
def test_a_list_is_of_what_a_run_takes_several_of(file, name, value, fits):
    settings = json.loads(file.read_text())[0]["settings"]
    change(file, settings=settings | {name: value})
    assert (read_or_refused(file) is not None) == fits


def test_a_run_of_recorded_episodes_may_hold_out_some_by_number(file):
    settings = json.loads(file.read_text())[0]["settings"]
    held_out = {"cameras": "cameras", "hold_out_view": ["side"], "hold_out_episodes": [3, 5]}
    change(file, settings=settings | {"task": "recorded"} | held_out)
    assert read_records(file)[0].settings["hold_out_episodes"] == [3, 5]


def test_rows_of_a_run_that_is_not_listed_are_refused(file):
    line = {"run": 5, "pair": 0, "status": "ok", "success": True}
    (file.parent / "rows.jsonl").write_text(json.dumps(line) + "\n")
    with pytest.raises(DatasetError, match="rows of run 5, of which"):
        read_results(file.parent, "test")
