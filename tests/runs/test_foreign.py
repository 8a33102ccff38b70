"""The record of a foreign policy's folder: kept, known again, and refused where it is damaged."""

import json
from dataclasses import replace

import numpy as np
import pytest

from jaxcam.errors import ConfigError, DatasetError
from jaxcam.files.jsonl import append_jsonl
from jaxcam.results.rows import Row
from jaxcam.runs.foreign import (
    FILE,
    ForeignRecord,
    as_json,
    digest,
    has_foreign,
    keep_record,
    read_foreign_record,
)
from jaxcam.runs.rollouts import read_run_rows, rows_file

RECORD = ForeignRecord(
    name="theirs", address="ws://localhost:8000", task="lift", scene="fixed", conditioning="none",
    views=1, resolution="96x128", action_space="eef_delta", rotations="nominal", execute=8,
    observation_steps=1, keys={"a": ["observation.state[0:7]"]}, answer="actions", prompt="Lift",
    metadata={"step": 1, "names": ["a"]}, weights_sha="0" * 16,
)  # fmt: skip


def test_a_record_comes_back_as_it_was(tmp_path):
    folder = tmp_path / "runs" / "a"
    assert not has_foreign(folder)
    keep_record(folder, RECORD)
    assert has_foreign(folder)
    assert read_foreign_record(folder) == RECORD
    assert RECORD.settings["policy"] == "theirs"
    assert RECORD.settings["preset"] is None


def test_a_server_may_move_if_it_says_who_it_is(tmp_path):
    moved = replace(RECORD, address="ws://elsewhere:1")
    keep_record(tmp_path, RECORD)
    keep_record(tmp_path, moved)
    assert read_foreign_record(tmp_path) == moved
    silent = tmp_path / "silent"
    keep_record(silent, replace(RECORD, metadata={}))
    with pytest.raises(ConfigError, match="address: 'ws://localhost:8000' -> 'ws://elsewhere:1'"):
        keep_record(silent, replace(moved, metadata={}))


def test_another_policy_is_refused_and_told_apart(tmp_path):
    keep_record(tmp_path, RECORD)
    other = replace(RECORD, metadata={"step": 2, "names": ["a"]}, weights_sha="1" * 16)
    with pytest.raises(ConfigError, match=r"another policy.*: metadata step: 1 -> 2\. Give"):
        keep_record(tmp_path, other)
    with pytest.raises(ConfigError, match="file has changed"):
        keep_record(tmp_path, replace(RECORD, weights_sha="1" * 16))
    run = tmp_path / "run"
    run.mkdir()
    (run / "config.json").write_text("{}")
    with pytest.raises(ConfigError, match="is the folder of a run"):
        keep_record(run, RECORD)


@pytest.mark.parametrize(
    ("change", "message"),
    [({"task": "lfit"}, "did you mean 'lift'"), ({"nmae": 1}, "nmae"), ({"views": "a"}, "views")],
)
def test_a_damaged_record_is_refused(tmp_path, change, message):
    keep_record(tmp_path, RECORD)
    content = json.loads((tmp_path / FILE).read_text("utf-8"))
    (tmp_path / FILE).write_text(json.dumps(content | change))
    with pytest.raises(ConfigError, match=message):
        read_foreign_record(tmp_path)


def test_rows_of_another_policy_are_refused_in_its_folder(tmp_path):
    keep_record(tmp_path, RECORD)
    row = Row(task="lift", scene="fixed", policy="theirs", conditioning="none", pair=0,
              status="policy", success=False, weights_sha="0" * 16, cause="too late")  # fmt: skip
    rows_file(tmp_path).parent.mkdir()
    append_jsonl(rows_file(tmp_path), row.to_json())
    assert [r.cause for r in read_run_rows(tmp_path)] == ["too late"]
    for change in ({"weights_sha": "1" * 16}, {"policy": "ours"}):
        append_jsonl(rows_file(tmp_path), replace(row, pair=1, **change).to_json())
        with pytest.raises(DatasetError, match="is not of this run"):
            read_run_rows(tmp_path)
        rows_file(tmp_path).write_text(json.dumps(row.to_json()) + "\n")


def test_whatever_a_policy_says_becomes_json(tmp_path):
    said = {1: np.float32([1, 2]), "n": np.int64(3), "odd": {"x": float("nan"), "y": b"\x00"},
            "text": "a\0\ud800", "large": 2**70, "none": None}  # fmt: skip
    kept = as_json(said)
    assert kept["1"] == [1, 2]
    assert (kept["n"], kept["none"], kept["odd"]["x"]) == (3, None, "nan")
    record = replace(RECORD, metadata=kept)
    keep_record(tmp_path, record)
    assert read_foreign_record(tmp_path) == record
    assert digest(kept) == digest(as_json(dict(reversed(said.items()))))


def test_what_has_no_end_is_cut():
    endless: dict = {"a": 1}
    endless["self"] = endless
    content = as_json(endless)
    assert content["self"]["self"]["a"] == 1
    assert json.dumps(content).endswith('"\\u2026"' + "}" * 50)
