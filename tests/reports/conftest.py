"""Runs that reports are made of."""

import pytest
from made_runs import make_run


@pytest.fixture
def runs(tmp_path):
    """Late fusion and its image-only twin on Lift, a seed each; a folder of runs."""
    folder = tmp_path / "runs"
    make_run(folder / "none", rate=0.25, conditioning="none", model=("twin_of=late",))
    make_run(folder / "late", rate=0.75, conditioning="late")
    return folder
