"""Every policy through the one trainer: it learns, resumes, and is rebuilt; one in a whole run."""

import dataclasses
import json
import shutil

import jax
import numpy as np
import pytest
import tiny_training
from conftest import PIXELS, TINY
from policy_inputs import jit

from jaxcam.config.names import PolicyName, names_of
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.files.jsonl import read_jsonl
from jaxcam.interrupts import Interrupt
from jaxcam.models import PolicySpec, make_policy, policy_settings
from jaxcam.pipeline.train import train
from jaxcam.runs.folder import RunDir
from jaxcam.runs.identity import resolve
from jaxcam.training.checkpoint import load_policy_inputs, rebuild_policy
from jaxcam.training.digests import read_all
from jaxcam.training.loop import Trainer
from jaxcam.training.state import Stream, stream_key

TOY = {
    "act": (
        "laptop",
        ("chunk=4", "encoder_width=8", "encoder_depth=1", "keypoints=3", "width=16", "layers=1"),
    ),
    # Two observation steps and a crop of its own.
    "diffusion": (
        "lerobot",
        ("chunk=4", "obs_steps=2", "encoder=small", "encoder_width=8", "encoder_depth=1",
         "keypoints=3", "features=8", "channels=(8,)", "step_width=8", "crop=12",
         "sample_steps=2"),
    ),
    "smolvla": (
        "tiny",
        ("chunk=4", "image_size=32", "layers=1", "vision_layers=1", "remat=False",
         "conditioning=token"),
    ),
}  # fmt: skip
"""Preset and changes with which a policy compiles in seconds."""
UPDATES = 60


def toy_policy(config):
    settings = policy_settings(config, ("Lift the cube",))
    size = tiny_training.PIXELS
    spec = PolicySpec(2, 3, 1, size, size, settings.chunk, settings.obs_steps)
    return make_policy(settings, spec, tiny_training.dataset().stats())


def toy_run(policy, folder):
    """Trains a run as `train` does once it has data; the state at its end."""
    preset, changes = TOY[policy]
    config = TrainConfig(
        policy=policy, preset=preset, model=changes, steps=UPDATES, batch=4, lr=3e-3,
        schedule="constant", warmup=0, ema=0.9, resolution=tiny_training.PIXELS, demos=4,
        validation=2, log_every=30, eval_every=30, save_every=30, steps_per_call=1,
        run_dir=str(folder),
    )  # fmt: skip
    config = resolve(config, accelerator=False)
    with RunDir.open(config) as run:
        trainer = Trainer(config, tiny_training.dataset(), toy_policy(config), Interrupt())
        return trainer.fit([config], [run])[0]


def mean_loss(policy):
    """A function of parameters: the loss on four training samples, over many draws of noise."""
    demos, spec = np.arange(tiny_training.TRAIN), policy.spec
    views = np.zeros((len(demos), 1), int)
    batch = tiny_training.dataset().batch(demos, demos, views, spec.chunk, spec.obs_steps)
    keys = jax.random.split(jax.random.key(1), 64)
    return jit(lambda params: jax.vmap(lambda key: policy.loss(params, batch, key)[0])(keys).mean())


@pytest.mark.parametrize("policy", names_of(PolicyName))
def test_every_policy_trains_resumes_and_is_rebuilt(policy, tmp_path):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    state = toy_run(policy, whole)
    rows = read_jsonl(whole / "metrics.jsonl")
    assert [row["step"] for row in rows] == [UPDATES // 2, UPDATES]
    inputs = load_policy_inputs(whole)
    rebuilt = rebuild_policy(inputs)
    assert dataclasses.asdict(rebuilt.config) == inputs.settings
    jax.tree.map(np.testing.assert_array_equal, inputs.params, state.eval_params)
    loss = mean_loss(rebuilt)
    first = jit(rebuilt.init)(stream_key(jax.random.key(0), Stream.INIT))
    assert loss(state.params) < loss(first)

    shutil.copytree(whole, parts)  # as a kill after the checkpoint in the middle leaves it
    shutil.rmtree(parts / "checkpoints" / str(UPDATES))
    toy_run(policy, parts)
    there, here = (read_all(run / "checkpoints" / str(UPDATES))[1] for run in (whole, parts))
    assert there.keys() == here.keys()
    for name, leaf in there.items():
        np.testing.assert_array_equal(here[name], leaf, err_msg=name)


SMALL = ("encoder=small", "encoder_width=8", "keypoints=3", "features=8", "channels=(8,16)",
         "step_width=8", "sample_steps=2", "crop=20")  # fmt: skip


@pytest.mark.slow
def test_diffusion_trains_resumes_and_evaluates(demos, tmp_path):
    """A whole run with DDPM, L2 decay and a moving average that rises."""
    config = TrainConfig(
        policy="diffusion",
        preset="lerobot",
        ema=0.99,
        ema_power=0.75,
        model=SMALL,
        **TINY,
        schedule="constant",
        warmup=0,
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
    with pytest.raises(ConfigError, match="another configuration"):
        train(dataclasses.replace(config, steps=4, policy="act", model=()))
