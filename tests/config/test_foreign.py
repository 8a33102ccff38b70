"""Flags of somebody else's policy, and its map: what goes together, and what cannot be."""

import pytest

from jaxcam.config.foreign import ForeignConfig, ObsMap
from jaxcam.errors import ConfigError


def test_an_address_says_whether_it_is_a_server():
    assert ForeignConfig(policy="ws://localhost:8000").is_server
    assert ForeignConfig(policy="wss://there").is_server
    assert not ForeignConfig(policy="module:function").is_server


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ({"task": "lift"}, "--task goes with --policy only"),
        ({"at_once": 2}, "--at-once goes with --policy only"),
        ({"policy": "a:b", "at_once": 2}, "--at-once is for servers"),
        ({"policy": "ws://a", "key": "x", "key_file": "y"}, "--key or --key-file"),
        ({"policy": "ws://a", "views": 0}, "views must be at least 1"),
        ({"policy": "ws://a", "execute": 2000}, "execute must be at most"),
        ({"policy": "ws://a", "resolution": "84x"}, "resolution must be"),
        ({"policy": "ws://a", "timeout": -1.0}, "timeout must be"),
        ({"policy": "ws://a", "action_space": "native"}, "Unknown action_space"),
        ({"policy": "ws://a", "scene": "fixd"}, "did you mean 'fixed'"),
    ],
)
def test_what_cannot_be_is_refused(flags, message):
    with pytest.raises(ConfigError, match=message):
        ForeignConfig(**flags)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"observation_steps": 0}, "observation_steps must be at least 1"),
        ({"resolution": 4}, "resolution must be at least 16"),
        ({"keys": {1: "a"}}, "keys must be str"),
        ({"answer": None}, "answer must be str"),
    ],
)
def test_a_map_is_checked(entries, message):
    with pytest.raises(ConfigError, match=message):
        ObsMap(**entries)
