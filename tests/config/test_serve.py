"""Settings of the policy server."""

import pytest

from jaxcam.config.flags import parse
from jaxcam.config.serve import ServeConfig
from jaxcam.errors import ConfigError


def test_flags_become_settings():
    config = parse(ServeConfig, ["runs/a", "--port", "0", "--key-file", "secret", "--width", "50"])
    assert (config.run, config.port, config.key_file, config.width) == ("runs/a", 0, "secret", 50)
    assert config.host == "127.0.0.1"


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"run": ""}, "No run"),
        ({"port": 65536}, "port must be at most 65535"),
        ({"port": -1}, "port must be at least 0"),
        ({"width": 0}, "width must be at least 1"),
        ({"clients": 0}, "clients must be"),
        ({"largest_mb": 5000}, "largest_mb must be"),
        ({"per_second": 0}, "per_second must be"),
        ({"ensemble": -2.0}, "ensemble must be at least -1"),
        ({"key": "a", "key_file": "b"}, "not both"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings, words):
    with pytest.raises(ConfigError, match=words):
        ServeConfig(**{"run": "runs/a", **settings})
