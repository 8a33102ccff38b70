"""Which checkpoints of a run are evaluated."""

import pytest

from jaxcam.config.train import TrainConfig
from jaxcam.errors import CheckpointError
from jaxcam.evaluation.run import steps_to_judge


def test_steps_of_the_protocol(tmp_path):
    trained = TrainConfig(steps=1000, save_every=100, keep=3, steps_per_call=1)
    for step in (550, 700, 800, 900):  # 550: where a signal stopped the run
        (tmp_path / "checkpoints" / str(step)).mkdir(parents=True)
    with pytest.raises(CheckpointError, match="trained to step 900 of 1000"):
        steps_to_judge(tmp_path, trained)
    (tmp_path / "checkpoints" / "1000").mkdir()
    steps, lacking = steps_to_judge(tmp_path, trained)
    assert steps == [1000, 900, 800, 700]
    assert "600, 500, 400, 300, 200, 100" in lacking[0]
