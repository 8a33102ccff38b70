"""What a foreign policy is sent: names, parts, and several observations."""

import numpy as np
import pytest

from jaxcam.config.foreign import ObsMap
from jaxcam.errors import ConfigError
from jaxcam.evaluation.mapping import (
    names_of_map,
    observation_sent,
    read_map,
    renamed,
    sent,
    write_map,
)

BATCH, VIEWS, SIDE = 2, 2, 16
RNG = np.random.default_rng(0)


def batch(*steps):
    """Observations of a batch, of several steps if that is said."""
    lead = (BATCH, *steps)
    return {
        "image": RNG.integers(0, 256, (*lead, VIEWS, SIDE, SIDE, 3), np.uint8),
        "K": np.broadcast_to(RNG.random((VIEWS, 3, 3), np.float32), (*lead, VIEWS, 3, 3)),
        "base_from_camera": np.broadcast_to(np.eye(4, dtype=np.float32), (*lead, VIEWS, 4, 4)),
        "proprio": RNG.random((*lead, 11), np.float32),
    }


def test_all_is_sent_under_our_names():
    obs = batch()
    message = sent(renamed(["view_0", "view_1"]), observation_sent(obs, 3, 1, "Lift"))
    assert list(message) == [
        "observation.images.view_0", "camera.view_0.intrinsics", "camera.view_0.base_from_camera",
        "observation.images.view_1", "camera.view_1.intrinsics", "camera.view_1.base_from_camera",
        "observation.state", "prompt",
    ]  # fmt: skip
    np.testing.assert_array_equal(message["observation.images.view_1"], obs["image"][1, 1])
    np.testing.assert_array_equal(message["camera.view_1.intrinsics"], obs["K"][1, 1])
    np.testing.assert_array_equal(message["observation.state"], obs["proprio"][1])
    assert message["prompt"] == "Lift"


def test_a_servers_own_names_of_views_are_used_and_chance_is_sent_where_it_is_asked_for():
    ours = observation_sent(batch(), 3, 1, "Lift")
    message = sent(renamed(["front", "wrist"], "call", "row"), ours)
    assert message["observation.images.wrist"] is ours["observation.images.view_1"]
    assert (message["call"], message["row"]) == (3, 1)


def test_several_observations_are_stacked_the_oldest_first():
    obs = batch(3)
    ours = observation_sent(obs, 0, 0, "")
    image = ours["observation.images.view_1"]
    assert image.shape == (3, SIDE, SIDE, 3)
    np.testing.assert_array_equal(image, obs["image"][0, :, 1])
    np.testing.assert_array_equal(ours["observation.state"], obs["proprio"][0])
    assert ours["camera.view_0.base_from_camera"].shape == (4, 4)
    part = sent(names_of_map({"joints": "observation.state[0:7]"}, VIEWS, 11), ours)["joints"]
    np.testing.assert_array_equal(part, obs["proprio"][0, :, :7])


def test_a_map_renames_takes_parts_and_joins(tmp_path):
    file = tmp_path / "map.yaml"
    file.write_text("""
keys:
  observation/exterior_image_1_left: observation.images.view_0
  observation/joint_position: observation/state[0:7]
  both: ["observation.state[0:7]", "observation.state[10:11]"]
  prompt: prompt
resolution: 96x128
action_space: joint_delta
execute: 8
answer: chunk
""")
    wanted = read_map(str(file))
    assert (wanted.resolution, wanted.action_space, wanted.execute) == ("96x128", "joint_delta", 8)
    obs = batch()
    ours = observation_sent(obs, 0, 0, "Lift")
    message = sent(names_of_map(wanted.keys, VIEWS, 11), ours)
    state = obs["proprio"][0]
    assert sorted(message) == sorted(wanted.keys)
    np.testing.assert_array_equal(message["observation/joint_position"], state[:7])
    np.testing.assert_array_equal(message["both"], [*state[:7], state[10]])
    write_map(tmp_path / "again.yaml", wanted)
    assert read_map(str(tmp_path / "again.yaml")) == wanted


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"a": "observation.images.view0"}, "did you mean 'observation.images.view_0'"),
        ({"a": "observation.images.view_7"}, "we have no 'observation.images.view_7'"),
        ({"a": "observation.state[0:12]"}, r"as \[0:11\]; got 'observation.state\[0:12\]'"),
        ({"a": "observation.state[3:3]"}, "has the numbers 0 to 10"),
        ({"a": "observation.images.view_0[0:2]"}, "only observation.state has parts"),
        ({"a": "observation.state[0]"}, r"we have no 'observation.state\[0\]'"),
        ({"a": 3}, "expected a name of ours"),
        ({"a": []}, "expected a name of ours"),
        ({}, "keys names nothing"),
        ({"a": ["observation.state", "prompt"]}, "only parts of observation.state can be joined"),
    ],
)
def test_what_we_have_not_is_told_with_the_closest_name(keys, message):
    with pytest.raises(ConfigError, match=message):
        names_of_map(keys, 1, 11)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("key: {}", "Unknown setting 'key', did you mean 'keys'"),
        ("action_space: joint_dleta", "did you mean 'joint_delta'"),
        ("execute: 0", "execute must be at least 1"),
        ("resolution: 8", "resolution must be at least 16"),
        ("keys: view", "keys must be dict or NoneType"),
        ("prompt: 3", "prompt must be str or NoneType"),
        ("- a", "expected entries such as keys"),
        ("a: [", "cannot be read: while parsing"),
        ("keys: {a: prompt, a: observation.state}", "'a' is there twice"),
        ("", "expected entries such as keys"),
    ],
)
def test_a_map_that_is_none_is_refused(tmp_path, text, message):
    file = tmp_path / "map.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=message):
        read_map(str(file))


def test_no_map_at_all(tmp_path):
    with pytest.raises(ConfigError, match="no such file"):
        read_map(str(tmp_path / "map.yaml"))
    assert ObsMap().keys is None
