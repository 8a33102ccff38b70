"""Runs that reports are made of."""

import pytest
from made_runs import make_run


@pytest.fixture
def runs(tmp_path):
    """Image-only and late fusion on Lift, a seed each; a folder of runs."""
    folder = tmp_path / "runs"
    for way, rate in (("none", 0.25), ("late", 0.75)):
        make_run(folder / way, rate=rate, conditioning=way)
    return folder
