"""Names of settings: that they are those of what they name."""

from typing import get_args

from places import REPO

from jaxcam.config.names import (
    ActionSpace,
    PolicyName,
    PresetName,
    SceneName,
    TaskName,
    names_of,
)
from jaxcam.config.presets import PRESETS
from jaxcam.models import FAMILIES
from jaxcam.sim.actions import ACTION_SPACES


def test_tasks_are_the_files_of_the_tasks():
    files = sorted(p.stem for p in (REPO / "jaxcam" / "sim" / "tasks").glob("[a-z]*.py"))
    assert list(get_args(TaskName)) == files


def test_policies_and_presets_are_those_of_the_models():
    assert set(get_args(PolicyName)) == set(FAMILIES)
    assert {(kind, name) for kind, f in FAMILIES.items() for name in f.presets} == set(PRESETS)
    assert {name for _, name in PRESETS} | {"auto"} == set(get_args(PresetName))
    for (kind, name), preset in PRESETS.items():
        assert FAMILIES[kind].presets[name].conditioning == preset.conditioning


def test_action_spaces_are_those_of_the_paper_and_one_more():
    assert get_args(ActionSpace)[:-1] == ACTION_SPACES


def test_names_within_other_types():
    assert names_of(SceneName | None) == names_of(tuple[SceneName, ...]) == get_args(SceneName)
    assert names_of(str | None) == ()
