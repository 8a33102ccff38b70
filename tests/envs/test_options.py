"""Options of environments: what they mean, and what is refused in words."""

import re

import pytest
from places import REPO

from jaxcam.config.names import TaskName, names_of
from jaxcam.envs import env_id
from jaxcam.envs.options import EnvOptions
from jaxcam.errors import ConfigError
from jaxcam.sim import make_task


@pytest.mark.parametrize("task", ["lift", "square", "push"])
def test_what_is_left_out_is_the_tasks(task):
    options, known = EnvOptions.of({"task": task}), make_task(task)
    assert (options.views, options.horizon) == (known.views, known.horizon)
    assert EnvOptions.of({"task": task, "views": 3}).views == 3


def test_the_documentation_says_what_they_are():
    page = (REPO / "docs/gymnasium.md").read_text(encoding="utf-8")
    rows = re.findall(r"\| `(jaxcam/\S+)` \|[^|]+\| (\d+) \| (\d+) \| (yes)? ?\|", page)
    tasks = {env_id(name): make_task(name) for name in names_of(TaskName)}
    assert {
        (id, int(views), int(horizon), bool(shaped)) for id, views, horizon, shaped in rows
    } == {(id, task.views, task.horizon, task.simulator == "mujoco") for id, task in tasks.items()}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"task": "lft"}, "Unknown task 'lft', did you mean 'lift'"),
        ({"scene": "random"}, "Unknown scene 'random', did you mean 'randomized'"),
        ({"action_space": "eef"}, "Unknown action_space 'eef'"),
        ({"action_space": None}, "action_space must be str"),
        ({"views": 0}, "views must be at least 1, got 0"),
        ({"views": 33}, "views must be at most 32"),
        ({"views": 1.5}, "views must be int"),
        ({"horizon": -1}, "horizon must be at least 1"),
        ({"chunk": 0}, "chunk must be at least 1"),
        ({"chunk": True}, "chunk must be int"),
        ({"resolution": "84x"}, "resolution must be a side"),
        ({"render_size": 8}, "render_size must be at least 16"),
        ({"rotations": "world"}, "rotations is for action_space eef_abs"),
        ({"engine": "mjx"}, "Unknown engine 'mjx'"),
        ({"reward": "dense"}, "Unknown reward 'dense'"),
        ({"task": "push", "reward": "shaped"}, "robosuite's reward, and this task is ManiSkill's"),
        ({"rewards": "shaped"}, "Unknown option 'rewards', did you mean 'reward'"),
    ],
)
def test_bad_options_are_refused_in_words(given, message):
    with pytest.raises(ConfigError, match=message):
        EnvOptions.of({"task": "lift", **given})
