"""Settings of the forms that need no tag."""

import pytest

from jaxcam.config.calibrate_arm import ArmConfig, DriftConfig
from jaxcam.errors import ConfigError


def test_a_camera_must_be_named():
    with pytest.raises(ConfigError, match="Which camera"):
        ArmConfig("cups")
    assert ArmConfig("cups", view="front").robot == "panda"


@pytest.mark.parametrize("given", [{"episodes": 0}, {"most": 2}, {"most": 10**9}])
def test_numbers_that_are_too_small_or_too_large(given):
    with pytest.raises(ConfigError, match=next(iter(given))):
        ArmConfig("cups", view="front", **given)
    with pytest.raises(ConfigError, match=next(iter(given))):
        DriftConfig("cups", **given)
