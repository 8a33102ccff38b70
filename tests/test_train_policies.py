"""Every policy through the one trainer and the one evaluator, resumed on the way."""

import dataclasses
import json

import pytest
from conftest import PIXELS, TINY

from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.pipeline import train
from jaxcam.training.checkpoint import load_policy_inputs, rebuild_policy

SMALL = {
    # Two observation steps, DDPM, L2 decay, a moving average that rises.
    "diffusion": {
        "preset": "lerobot",
        "warmup": 0,
        "ema": 0.99,
        "ema_power": 0.75,
        "model": (
            "encoder=small", "encoder_width=8", "keypoints=3", "features=8", "channels=(8,16)",
            "step_width=8", "sample_steps=2", "crop=20",
        ),
    },
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("policy", sorted(SMALL))
def test_trains_resumes_evaluates_and_is_rebuilt(policy, demos, tmp_path):
    config = TrainConfig(
        policy=policy,
        **SMALL[policy],
        **TINY,
        schedule="constant",
        resolution=PIXELS,
        batch=2,
        steps=2,
        pairs=2,
        log_every=1,
        eval_every=2,
        save_every=2,
        data_dir=str(demos.path.parent),
        run_dir=str(tmp_path / "run"),
    )
    assert train(config) == 0
    assert train(dataclasses.replace(config, steps=4)) == 0
    rows = [json.loads(line) for line in (tmp_path / "run/metrics.jsonl").read_text().splitlines()]
    assert [r["step"] for r in rows if "loss" in r] == [1, 2, 3, 4]
    assert [r["step"] for r in rows if "success_rate" in r] == [2, 4]
    inputs = load_policy_inputs(tmp_path / "run")
    rebuilt = rebuild_policy(inputs)
    assert dataclasses.asdict(rebuilt.config) == inputs.settings
    with pytest.raises(ConfigError, match="another configuration"):
        train(dataclasses.replace(config, steps=4, policy="act", model=()))
