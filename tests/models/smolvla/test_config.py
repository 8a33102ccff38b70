"""What settings of SmolVLA are refused."""

from dataclasses import replace

import pytest

from jaxcam.errors import ConfigError
from jaxcam.models.smolvla.config import SMOLVLA_PRESETS

TINY = replace(
    SMOLVLA_PRESETS["tiny"], chunk=4, image_size=32, layers=1, vision_layers=1, remat=False
)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tokens": (0,) * 49}, "has 49 tokens; SmolVLA takes 48"),
        ({"tokens": (8,)}, "Tokens must be 0 to 7"),
        ({"conditioning": "early"}, "no conditioning 'early', only none, token, late, warp, prope"),
        ({"conditioning": "prope", "head_dim": 12}, "multiple of 8 channels; head_dim is 12"),
        ({"conditioning": "gta", "encoder": "small", "pool": "keypoints"}, "model pool=grid"),
        ({"image_size": 33}, "not a multiple of patch 8 times shuffle 4"),
        ({"heads": 4, "kv_heads": 3}, "heads of kv_heads"),
        ({"attention": "interleaved", "layers": 3}, "come in pairs, got 3"),
        ({"attention": "cross"}, "Unknown attention 'cross'"),
    ],
)
def test_settings_that_cannot_work(changes, message):
    with pytest.raises(ConfigError, match=message):
        replace(TINY, **changes)
