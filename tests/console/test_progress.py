"""Progress in files, where a bar cannot be drawn over."""

import io
import re

import pytest
from rich.console import Console

from jaxcam.console import progress as module
from jaxcam.console.progress import progress


def written(total: int, *, seconds: float, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    monkeypatch.setattr(module, "LINE_SECONDS", seconds)
    file = io.StringIO()
    with progress(Console(file=file), "training", total, done=2) as advance:
        for i in range(total - 2):
            advance(1, f"loss {i}")
    return file.getvalue().splitlines()


def test_a_log_gets_a_line_now_and_then(monkeypatch: pytest.MonkeyPatch):
    lines = written(5, seconds=0.0, monkeypatch=monkeypatch)
    pattern = r"training 3 of 5, \d+:\d\d:\d\d gone, \d+:\d\d:\d\d left  loss 0"
    assert re.fullmatch(pattern, lines[0])
    assert len(lines) == 4
    assert re.fullmatch(r"training 5 of 5, \d+:\d\d:\d\d in all  loss 2", lines[-1])


def test_a_short_job_leaves_one_line(monkeypatch: pytest.MonkeyPatch):
    assert len(written(50, seconds=60.0, monkeypatch=monkeypatch)) == 1
