"""What the settings of datasets refuse, and which dataset a run trains on."""

import pytest

from jaxcam.config.datasets import CollectConfig, LerobotConfig, ReplayConfig, RobomimicConfig
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError


@pytest.mark.parametrize(
    ("kind", "settings", "message"),
    [
        (CollectConfig, {"task": "lifts"}, "did you mean 'lift'"),
        (CollectConfig, {"demos": 0}, "demos must be at least 1"),
        (CollectConfig, {"validation": -1}, "validation must be at least 0"),
        (CollectConfig, {"n": 0}, "n must be at least 1"),
        (ReplayConfig, {"dataset": "a", "action_space": ("eef_delta", "eef")},
         "Unknown action_space 'eef', did you mean 'eef_abs'"),
        (RobomimicConfig, {"file": "a", "actions": "states "}, "did you mean 'states'"),
        (RobomimicConfig, {"file": "a", "validation": -1}, "validation must be at least 0"),
        (LerobotConfig, {"dataset": "a", "out": "b", "resolution": 85}, "even for video, got 85"),
        (LerobotConfig, {"dataset": "a", "out": "b", "resolution": 8}, "at least 16"),
    ],
)  # fmt: skip
def test_bad_settings_are_refused(kind, settings, message):
    with pytest.raises(ConfigError, match=message):
        kind(**settings)


def test_the_dataset_of_a_run_does_not_depend_on_its_seed():
    one, other = (CollectConfig.of(TrainConfig(task="square", demos=7, seed=s)) for s in (0, 3))
    assert one == other
    assert (one.task, one.demos, one.seed) == ("square", 7, 0)
