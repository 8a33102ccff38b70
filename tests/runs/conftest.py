"""Grid files whose runs are fakes."""

import sys

import pytest
from small_grid import FAKE, SMALL

from jaxcam.runs import grid, sweep


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Writes a grid file whose runs are fakes."""
    monkeypatch.setattr(grid, "PYTHON", (sys.executable, str(FAKE)))
    monkeypatch.setattr(sweep, "SECONDS", 0.02)

    def write(text=SMALL):
        path = tmp_path / "grid.yaml"
        path.write_text(text.format(folder=tmp_path))
        return path

    return write
