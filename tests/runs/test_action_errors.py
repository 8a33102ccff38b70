"""Rows of action errors in a run's folder."""

import numpy as np
import pytest

from jaxcam.errors import DatasetError
from jaxcam.files.jsonl import append_jsonl
from jaxcam.results.actions import ActionErrors
from jaxcam.runs.action_errors import errors_file, read_errors


def test_rows_are_read_in_order_and_damage_is_told(tmp_path):
    assert read_errors(tmp_path) == []
    rows = [
        ActionErrors(step, "new episodes", 0.0, 0.0, ("x",), np.ones(1), np.ones((1, 2, 1)))
        for step in (5, 10)
    ]
    file = errors_file(tmp_path)
    file.parent.mkdir()
    append_jsonl(file, *(row.to_json() for row in rows))
    assert [row.step for row in read_errors(tmp_path)] == [5, 10]
    append_jsonl(file, rows[0].to_json() | {"scale": [1, 2]})
    with pytest.raises(DatasetError, match=r"actions\.jsonl, line 3: no row of action errors"):
        read_errors(tmp_path)
