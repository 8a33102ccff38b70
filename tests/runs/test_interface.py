"""Names of what a run's policy is shown and what it answers."""

from dataclasses import replace

import pytest

from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.models import PolicySpec
from jaxcam.runs.identity import resolve
from jaxcam.runs.interface import FILE, Interface, read_interface, write_interface

SPEC = PolicySpec(action_dim=2, proprio_dim=3, views=1, height=16, width=16, chunk=4)
NAMES = Interface(("front", "wrist"), ("x", "y", "z"), ("dx", "grip"), 12.5, "Lift it.")
RECORDED = resolve(TrainConfig(task="recorded"), accelerator=False)


def test_a_record_comes_back(tmp_path):
    write_interface(tmp_path, NAMES)
    assert read_interface(tmp_path, RECORDED, SPEC) == NAMES


def test_older_runs_have_the_names_of_their_task_or_numbers(tmp_path):
    lift = resolve(TrainConfig(action_space="joint_abs"), accelerator=False)
    of_lift = read_interface(tmp_path, lift, SPEC)
    assert of_lift.views == ("view_0",)
    assert (len(of_lift.state_names), of_lift.action_names[-2:]) == (11, ("joint_7", "gripper"))
    assert (of_lift.rate, of_lift.prompt) == (20, "Lift the cube")
    older = read_interface(tmp_path, RECORDED, SPEC)
    assert older == Interface(
        ("view_0",), ("state_0", "state_1", "state_2"), ("action_0", "action_1")
    )


@pytest.mark.parametrize("text", ["{", "[]", '{"views": 3}', '{"views": ["a"]}', ""])
def test_a_damaged_record_is_told(tmp_path, text):
    (tmp_path / FILE).write_text(text)
    with pytest.raises(ConfigError, match=r"damaged: .*delete it"):
        read_interface(tmp_path, RECORDED, SPEC)


@pytest.mark.parametrize("changes", [{"proprio_dim": 4}, {"action_dim": 3}, {"views": 3}])
def test_a_record_of_another_policy_is_told(tmp_path, changes):
    write_interface(tmp_path, NAMES)
    with pytest.raises(ConfigError, match="of another policy"):
        read_interface(tmp_path, RECORDED, replace(SPEC, **changes))


def test_a_rate_that_cannot_be_is_refused():
    with pytest.raises(ConfigError, match="rate"):
        replace(NAMES, rate=0.0)
