"""Files of rows say which line is none."""

import json

import pytest

from jaxcam.errors import DatasetError
from jaxcam.reports.arms import read_runs
from jaxcam.results.rows import Row
from jaxcam.runs.rollouts import read_rows, rows_file


def test_rows_are_read_in_order_and_a_line_that_is_none_is_named(tmp_path):
    file = rows_file(tmp_path)
    assert read_rows(file) == []
    file.parent.mkdir()
    rows = [Row(pair=pair, status="ok", success=True) for pair in (2, 0)]
    lines = "".join(json.dumps(row.to_json()) + "\n" for row in rows)
    file.write_text(lines)
    assert read_rows(file) == rows
    file.write_text(lines + '{"pair": 1}\n')
    with pytest.raises(DatasetError, match=r"rows\.jsonl, line 3: status is missing"):
        read_rows(file)


@pytest.mark.parametrize("line", ["5", '{"pair": 0, "status": "ok"}', '{"run": 0, "pair": 0}'])
def test_a_results_folder_names_the_line_that_is_none(tmp_path, line):
    record = {"run": 0, "name": "a", "seed": 0, "seconds": 0, "settings": {"task": "lift"}}
    (tmp_path / "runs.json").write_text(json.dumps([record]))
    (tmp_path / "rows.jsonl").write_text(line + "\n")
    with pytest.raises(DatasetError, match=r"rows\.jsonl, line 1: "):
        read_runs([tmp_path])
