"""On what terms a foreign policy is evaluated: flags, its map, and what it says itself."""

import pytest

from jaxcam.config.foreign import ForeignConfig, ObsMap
from jaxcam.errors import ConfigError
from jaxcam.evaluation.terms import map_of, names_sent, settled

SAID = {
    "server": "jaxcam", "run": "lift-randomized-act", "task": "square", "conditioning": "late",
    "views": ["front", "side"], "image_size": [96, 128], "action_space": "eef_abs",
    "rotations": "world", "execute": 4, "observation_steps": 2, "prompt": "Do it", "width": 50,
    "draws": True,
}  # fmt: skip


class Speaking:
    """A policy that says something of itself."""

    address, sha, at_once = "ws://localhost:8000", "0" * 16, 1

    def __init__(self, **metadata):
        self.metadata = metadata


def agreed(wanted=None, said=None, **flags):
    flags = ForeignConfig(policy="ws://localhost:8000", **flags)
    return settled(flags, wanted or ObsMap(), Speaking(**(said or {})))


def test_what_nobody_says_is_the_usual():
    record = agreed()
    assert (record.name, record.task, record.scene) == ("localhost-8000", "lift", "randomized")
    assert (record.views, record.resolution, record.action_space) == (1, 84, "eef_delta")
    assert (record.execute, record.observation_steps, record.prompt) == (None, 1, "Lift the cube")
    assert record.conditioning == "not said"


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"image": "observation.images.view_0"}, "none"),
        ({"image": "observation.images.view_0", "K": "camera.view_0.intrinsics"}, "not said"),
        ({"pose": "camera/view_0/base_from_camera"}, "not said"),
    ],
)
def test_who_is_sent_no_camera_is_told_none(keys, expected):
    """One that is sent its camera and says nothing is not taken for one that sees images only."""
    assert agreed(ObsMap(keys=keys)).conditioning == expected
    assert agreed(ObsMap(keys=keys), {"conditioning": "late"}).conditioning == "late"
    assert agreed(ObsMap(keys=keys, conditioning="token"), SAID).conditioning == "token"


def test_a_server_says_what_it_wants_and_is_known_by():
    record = agreed(said=SAID)
    assert (record.name, record.task, record.views) == ("lift-randomized-act", "square", 2)
    assert (record.resolution, record.action_space) == ("96x128", "eef_abs")
    assert (record.rotations, record.execute, record.observation_steps) == ("world", 4, 2)
    assert (record.conditioning, record.prompt) == ("late", "Do it")
    names = names_sent(record, 50)
    assert "observation.images.front" in names
    assert "row" in names
    assert "row" not in names_sent(record, 20)  # it would draw other chance
    assert agreed(said=SAID, action_space="eef_delta").rotations == "nominal"


def test_flags_come_before_the_map_and_that_before_the_server():
    wanted = ObsMap(resolution=64, action_space="joint_abs", execute=2, prompt="Map")
    record = agreed(wanted, SAID, resolution=32, task="lift", name="mine")
    assert (record.name, record.task, record.resolution) == ("mine", "lift", 32)
    assert (record.action_space, record.execute, record.prompt) == ("joint_abs", 2, "Map")
    assert settled(ForeignConfig(policy="ws://a", task="lift", resolution=32, name="mine"),
                     map_of(record), Speaking(**SAID)) == record  # fmt: skip


@pytest.mark.parametrize("odd", [3, None, "wide", [], [0, 84], ["a", 2], {"a": 1}, True, -1.5])
def test_what_others_say_in_another_form_is_not_used(odd):
    names = set(SAID) - {"server", "width", "draws"}
    record = agreed(said={name: odd for name in names if not isinstance(odd, type(SAID[name]))})
    usual = agreed()
    for name in ("task", "resolution", "action_space", "observation_steps", "rotations"):
        assert getattr(record, name) == getattr(usual, name)


@pytest.mark.parametrize("name", ["../evil", "a b", "", "-x", "x" * 81, "act", "ACT", "é"])
def test_names_are_names_of_files(name):
    if name:
        with pytest.raises(ConfigError, match="--name"):
            agreed(name=name)
    record = agreed(said={"run": name})
    assert "/" not in record.name
    assert record.name.lower() not in ("", "act")
    assert agreed(name=record.name).name == record.name


def test_views_of_one_name_are_no_names():
    assert agreed(said={"views": ["a", "a"]}).views == agreed().views
