"""Settings of a run: values that cannot be meant are refused, with what to do."""

import pytest

from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"task": "lfit"}, "Unknown task 'lfit', did you mean 'lift'. Known: lift"),
        ({"policy": "atc"}, "Unknown policy 'atc', did you mean 'act'"),
        ({"scene": "randomised"}, "did you mean 'randomized'"),
        ({"conditioning": "keypoint"}, "did you mean 'keypoints'"),
        ({"action_space": "ee_delta"}, "did you mean 'eef_delta'"),
        ({"preset": "papr"}, "did you mean 'paper'"),
        ({"action_frame": "camera", "action_space": "joint_abs"}, "eef_delta or eef_abs, and not"),
        ({"action_frame": "camera", "action_space": "native"}, "and not native"),
        ({"action_frame": "camera", "ray_frame": "grip"}, "ray_frame base, not grip"),
        ({"conditioning": "warp", "ray_frame": "world"}, "ray_frame base, not world"),
        ({"batch": 0}, "batch must be at least 1, got 0"),
        ({"lr": 0.0}, "lr must be finite and more than 0"),
        ({"lr": float("nan")}, "lr must be"),
        ({"clip_norm": float("inf")}, "clip_norm must be"),
        ({"crop_min": 1.5}, "crop_min is a share of the image"),
        ({"color_jitter": 1.5}, "color_jitter is a share, at most 1; got 1.5"),
        ({"color_jitter": -0.1}, "color_jitter must be at least 0"),
        ({"ema": 1.0}, "ema must be below 1"),
        ({"n": 3, "m": 4}, r"m \(4\) must be at most n \(3\)"),
        ({"views": 4, "n": 3}, r"views \(4\) needs as many cameras"),
        ({"seed": -1}, "A seed must be 0 to 4294967295"),
        ({"steps": 1.5}, "steps must be int or NoneType, got 1.5"),
        ({"batch": True}, "batch must be int"),
        ({"task": None}, "task must be str, got None"),
        ({"model": ("width",)}, "model: expected name=value, got 'width'"),
        ({"model": ("a=1", "a=2")}, "'a' is given twice"),
    ],
)
def test_bad_values_are_refused(changes, message):
    with pytest.raises(ConfigError, match=message):
        TrainConfig(**changes)
