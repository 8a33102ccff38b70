"""What settings of Diffusion Policy are refused."""

import pytest
from tiny_diffusion import make, tiny

from jaxcam.errors import ConfigError


@pytest.mark.parametrize(
    ("changes", "hint"),
    [
        ({"sampler": "dddim"}, "did you mean 'ddim'"),
        ({"padding": "samples"}, "did you mean 'sample'"),
        ({"chunk": 5}, "chunk 5 is not a multiple of 2"),
        ({"channels": (8, 12)}, "not multiples of groups 8"),
        ({"sample_steps": 101}, "sample_steps must be 1 to"),
        ({"conditioning": "prope"}, "no conditioning 'prope': that is geometry in attention"),
        ({"obs_steps": 4}, "obs_steps must be 1 to 3"),
        ({"temperature": -1.0}, "temperature must be at least 0, got -1"),
    ],
)
def test_what_cannot_work_is_refused(changes, hint):
    with pytest.raises(ConfigError, match=hint):
        tiny(**changes)


def test_a_crop_must_fit():
    with pytest.raises(ConfigError, match=r"20 pixels does not fit in 16x16"):
        make(tiny(crop=20))
