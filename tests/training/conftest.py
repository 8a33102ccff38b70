"""A run folder with checkpoints."""

import pytest
from tiny_checkpoints import SIDE, fresh, train

from jaxcam.training.checkpoint import Checkpoints


@pytest.fixture
def run(tmp_path):
    """A run folder with checkpoints of steps 1, 2 and 3."""
    with Checkpoints(tmp_path / "checkpoints") as checkpoints:
        state = fresh()
        for step in (1, 2, 3):
            state = train(state, step)
            checkpoints.save(state, SIDE)
    return tmp_path
