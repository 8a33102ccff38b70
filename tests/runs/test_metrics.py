"""Metrics of a run are read whole or refused with their line."""

import json
import math

import pytest

from jaxcam.errors import DatasetError
from jaxcam.runs.metrics import read_metrics


def write(folder, *rows):
    (folder / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))


def test_rows_are_read_in_order_and_none_is_no_rows(tmp_path):
    assert read_metrics(tmp_path) == []
    write(tmp_path, {"step": 50, "loss": 0.5}, {"step": 100, "loss": math.nan})
    first, second = read_metrics(tmp_path)
    assert first == {"step": 50, "loss": 0.5}
    assert math.isnan(second["loss"])


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ({"loss": 1.0}, "no 'step'"),
        ({"step": 1.5}, "step is 1.5, expected a whole number"),
        ({"step": -1}, "step is -1"),
        ({"step": True}, "'step' is True, expected a number"),
        ({"step": 2, "loss": "low"}, "'loss' is 'low', expected a number"),
        ({"step": 2, "success_rate": 1.2, "low": 0, "high": 1}, "success_rate is 1.2"),
        ({"step": 2, "success_rate": 0.5}, "without its interval"),
        ({"step": 2, "loss": 2**70}, "beyond 64 bits"),
    ],
)
def test_what_is_no_row_of_metrics_is_refused_with_its_line(tmp_path, row, message):
    write(tmp_path, {"step": 1, "loss": 1.0}, row)
    with pytest.raises(DatasetError, match=rf"metrics.jsonl, line 2: .*{message}"):
        read_metrics(tmp_path)
