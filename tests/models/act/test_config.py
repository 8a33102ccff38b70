"""What settings of ACT are refused."""

import pytest
from policy_inputs import (
    ACTION,
    CHUNK,
    PROPRIO,
    make_stats,
    tiny,
)

from jaxcam.errors import ConfigError
from jaxcam.models import PolicySpec, make_policy


def test_what_does_not_go_together_is_refused():
    config, stats = tiny("laptop", "keypoints"), make_stats()
    with pytest.raises(ConfigError, match="predicts 4 actions but the data has chunks of 9"):
        make_policy(config, PolicySpec(ACTION, PROPRIO, 1, 16, 16, 9), stats)
    with pytest.raises(ConfigError, match="Statistics of proprio"):
        make_policy(config, PolicySpec(ACTION, 2, 1, 16, 16, CHUNK), stats)
    with pytest.raises(ConfigError, match="not a multiple of heads"):
        tiny("paper", "late", width=17)
    with pytest.raises(ConfigError, match="did you mean 'mlp'"):
        tiny("laptop", "late", head="mpl")
    with pytest.raises(ConfigError, match="take --preset attention or paper"):
        tiny("laptop", "prope")
    with pytest.raises(ConfigError, match="take --preset attention"):
        tiny("attention", "gta", pool="keypoints")
    with pytest.raises(ConfigError, match="teaches 2 heat maps: take --conditioning keypoints"):
        tiny("attention", "late", heatmap_weight=1.0)
    with pytest.raises(ConfigError, match="teaches 2 heat maps"):
        tiny("laptop", "keypoints", heatmap_weight=1.0, keypoints=1)
    with pytest.raises(ConfigError, match="warp has its heat maps over others"):
        tiny("laptop", "warp", heatmap_weight=1.0)
    with pytest.raises(ConfigError, match="heatmap_weight needs keyframes"):
        tiny("laptop", "keypoints", heatmap_weight=1.0, keyframe_weight=0.0)
    with pytest.raises(ConfigError, match="action_frame camera has them in another frame"):
        tiny("laptop", "keypoints", heatmap_weight=1.0, action_frame="camera")
    with pytest.raises(ConfigError, match="width 16 over heads 4 is 4"):
        tiny("attention", "ray_rope", heads=4)
