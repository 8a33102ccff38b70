"""Training: seeds side by side, accumulated gradients, and what can go wrong on the way."""

import dataclasses
import json
import logging
import shutil
import signal
import subprocess
import sys
import time

import jax.numpy as jnp
import numpy as np
import pytest
import tiny_training
from tiny_training import fit, settings

import jaxcam.training.side_by_side
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError, DivergedError
from jaxcam.files.jsonl import read_jsonl
from jaxcam.interrupts import Interrupt
from jaxcam.pipeline.train import each_seed
from jaxcam.runs.folder import RunDir
from jaxcam.training.checkpoint import checkpoint_steps
from jaxcam.training.digests import read_all
from jaxcam.training.loop import Trainer
from jaxcam.training.watch import GradientWatch


def arrays(folder, step):
    return read_all(folder / "checkpoints" / str(step))[1]


def assert_close(folder, other, step=6, **tolerance):
    here, there = arrays(folder, step), arrays(other, step)
    assert here.keys() == there.keys()
    for name in here:
        np.testing.assert_allclose(here[name], there[name], err_msg=name, **tolerance)


def losses(folder):
    return {r["step"]: r["loss"] for r in read_jsonl(folder / "metrics.jsonl")}


@pytest.fixture(scope="module")
def singles(tmp_path_factory):
    """Folders of seeds 0, 1 and 2, each trained alone."""
    folder = tmp_path_factory.mktemp("singles")
    for seed in range(3):
        fit(settings(folder / str(seed), seed=seed))
    return folder


def side_by_side(folder, seeds, **changes):
    return fit(*(settings(folder / str(seed), seed=seed, **changes) for seed in seeds))


def test_seeds_side_by_side_are_the_runs_of_their_own(singles, tmp_path):
    states = side_by_side(tmp_path, range(3))
    assert [int(s.step) for s in states] == [6, 6, 6]
    for seed in "012":
        assert checkpoint_steps(tmp_path / seed) == [*range(1, 7)]
        assert_close(singles / seed, tmp_path / seed, rtol=1e-5, atol=1e-6)
        assert losses(tmp_path / seed) == pytest.approx(losses(singles / seed), rel=1e-5)
        config = json.loads((tmp_path / seed / "config.json").read_text())
        assert (config["seed"], config["seeds"]) == (int(seed), [])
    assert losses(tmp_path / "0") != losses(tmp_path / "1")


def test_seeds_that_stand_apart_meet_again(singles, tmp_path):
    """As a kill between two saves leaves them: nothing is lost or trained twice."""
    side_by_side(tmp_path, range(3), steps=3)
    shutil.rmtree(tmp_path / "1" / "checkpoints" / "3")
    shutil.rmtree(tmp_path / "2" / "checkpoints")
    fit(settings(tmp_path / "0", steps=5))
    kept = {p: p.stat().st_mtime_ns for p in tmp_path.glob("*/checkpoints/*/manifest/metadata")}
    side_by_side(tmp_path, range(3))
    assert {p: p.stat().st_mtime_ns for p in kept} == kept
    for seed in "012":
        assert_close(singles / seed, tmp_path / seed, rtol=1e-5, atol=1e-6)
        steps = [r["step"] for r in read_jsonl(tmp_path / seed / "metrics.jsonl")]
        assert steps == [*range(1, 7)]


def test_a_signal_stops_all_seeds_after_saving(tmp_path):
    stop = Interrupt()
    stop.signal = signal.SIGTERM
    configs = [settings(tmp_path / str(s), seed=s, save_every=6) for s in range(2)]
    states = fit(*configs, stop=stop)
    assert [int(s.step) for s in states] == [1, 1]
    assert [checkpoint_steps(tmp_path / str(s)) for s in range(2)] == [[1], [1]]


def test_each_seed_has_its_own_folder():
    named = TrainConfig(seeds=(3, 5), run_dir="runs/x", preset="laptop")
    assert [(c.seed, c.seeds, c.run_dir) for c in each_seed(named)] == [
        (3, (), "runs/x-3"), (5, (), "runs/x-5")
    ]  # fmt: skip
    unnamed = each_seed(dataclasses.replace(named, run_dir=None))
    assert [c.run_dir for c in unnamed] == [
        f"runs/lift-randomized-act-laptop-keypoints-{seed}" for seed in (3, 5)
    ]
    assert each_seed(TrainConfig(seed=4, preset="laptop"))[0].seed == 4
    for seeds in ((1, 1), (-1, 2)):
        with pytest.raises(ConfigError, match=r"seeds must be different|A seed must be 0 to"):
            TrainConfig(seeds=seeds)


@pytest.mark.parametrize("parts", [2, 12])
def test_accumulated_gradients_are_those_of_the_whole_batch(singles, tmp_path, parts):
    fit(settings(tmp_path / "whole"), noise=0.0)
    fit(settings(tmp_path / "parts", accumulate=parts), noise=0.0)
    assert_close(tmp_path / "whole", tmp_path / "parts", rtol=1e-5, atol=1e-6)
    # Random numbers are the parts' own, and a run does not change them on its way.
    with pytest.raises(ConfigError, match=f"accumulate: 1 -> {parts}"):
        fit(settings(singles / "0", accumulate=parts))


def test_a_batch_is_a_multiple_of_its_parts():
    with pytest.raises(ConfigError, match=r"batch \(12\) must be a multiple of accumulate \(5\)"):
        TrainConfig(batch=12, accumulate=5)


def test_a_run_that_died_before_its_first_checkpoint_begins_anew(singles, tmp_path):
    config = settings(tmp_path / "run")
    with RunDir.open(config) as run:
        run.log({"step": 1, "loss": 9.0})
        (run.checkpoints / "1.orbax-checkpoint-tmp-7").mkdir(parents=True)
    fit(config)
    assert losses(tmp_path / "run") == losses(singles / "0")
    assert_close(tmp_path / "run", singles / "0", rtol=0)


def test_a_finished_run_says_so(singles, capsys):
    from rich.console import Console

    config = settings(singles / "0")
    before = losses(singles / "0")
    with RunDir.open(config) as run:
        trainer = Trainer(config, tiny_training.dataset(), tiny_training.policy(), Interrupt(),
                          Console(width=200))  # fmt: skip
        trainer.fit([config], [run])
    assert "Trained to update 6 already" in capsys.readouterr().out
    assert losses(singles / "0") == before


def test_a_run_through_a_link(singles, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "run").symlink_to(tmp_path / "elsewhere")
    fit(settings(tmp_path / "run", steps=3))
    fit(settings(tmp_path / "run"))
    assert_close(tmp_path / "elsewhere", singles / "0", rtol=0)


def broken(monkeypatch, value):
    """Every action of the third update on is `value`."""
    real = jaxcam.training.side_by_side.stacked_batches

    def batches(*args, **sizes):
        for step, batch in real(*args, **sizes):
            if step >= 2:
                batch = {**batch, "action": np.full_like(batch["action"], value)}
            yield step, batch

    monkeypatch.setattr(jaxcam.training.side_by_side, "stacked_batches", batches)


def test_divergence_names_the_seed_and_keeps_the_batch(monkeypatch, tmp_path):
    broken(monkeypatch, np.nan)
    with pytest.raises(DivergedError, match="seed 3 was not finite in 10 updates in a row"):
        fit(settings(tmp_path / "run", seed=3, steps=30, save_every=2))
    with np.load(tmp_path / "run" / "diverged.npz") as kept:
        assert np.isnan(kept["action"]).all()
        assert kept["image"].shape[:2] == (1, 12)
    assert checkpoint_steps(tmp_path / "run")[0] == 2
    assert [r["skipped"] for r in read_jsonl(tmp_path / "run" / "metrics.jsonl")][:4] == [
        0,
        0,
        1,
        1,
    ]


def test_gradients_that_explode_are_told_once_they_do(monkeypatch, tmp_path, caplog):
    usual, huge = {"grad_norm": 0.5}, {"grad_norm": 60.0}
    watch = GradientWatch(4)
    for step in range(6):
        watch.look({"step": step, **usual})
    assert not caplog.text
    watch.look({"step": 6, **huge})
    assert "Seed 4: around update 6 the gradient's norm is 60, 120 times the usual" in caplog.text
    broken(monkeypatch, 1e6)
    fit(settings(tmp_path / "run", steps=3))
    assert read_jsonl(tmp_path / "run" / "metrics.jsonl")[-1]["grad_norm"] > 1e4


def test_memory_that_does_not_suffice_is_told(monkeypatch, tmp_path):
    policy = tiny_training.policy()

    def too_large(params, batch, key):
        value, metrics = policy.loss(params, batch, key)
        return value + jnp.cumsum(jnp.ones((10**6, 10**8)) * value, 0)[-1, -1], metrics

    config = settings(tmp_path / "run", validation=0)
    with RunDir.open(config) as run:
        trainer = Trainer(config, tiny_training.dataset(),
                          dataclasses.replace(policy, loss=too_large), Interrupt())  # fmt: skip
        with pytest.raises(ConfigError, match=r"12 samples in 1 parts, float32: .*--accumulate 2"):
            trainer.fit([config], [run])


def test_a_disk_without_room_for_metrics_does_not_stop_the_training(monkeypatch, tmp_path, caplog):
    def full(run, row):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(RunDir, "log", full)
    with caplog.at_level(logging.WARNING):
        (state,) = fit(settings(tmp_path / "run"))
    assert int(state.step) == 6
    assert "Metrics of update 3 are lost: [Errno 28] No space left on device" in caplog.text
    assert checkpoint_steps(tmp_path / "run") == [*range(1, 7)]


def test_a_run_of_an_older_version_goes_on(singles, tmp_path):
    """Without the settings and the digests that are newer than it."""
    shutil.copytree(singles / "0", tmp_path / "run")
    file = tmp_path / "run" / "config.json"
    config = json.loads(file.read_text())
    for name in ("accumulate", "seeds", "log", "distributed"):
        del config[name]
    file.write_text(json.dumps(config))
    for digests in tmp_path.glob("run/checkpoints/*/files.json"):
        digests.unlink()

    fit(settings(tmp_path / "run", steps=7))
    fit(settings(singles / "0", steps=7))
    assert_close(tmp_path / "run", singles / "0", step=7, rtol=0)


def test_other_devices_are_reported(singles, tmp_path, monkeypatch, caplog):
    shutil.copytree(singles / "1", tmp_path / "run")
    known = jaxcam.runs.environment.environment()
    monkeypatch.setattr(
        jaxcam.runs.environment, "environment", lambda: known | {"devices": "gpu A, gpu A"}
    )
    fit(settings(tmp_path / "run", seed=1))
    assert "not bit-exact: devices cpu cpu -> gpu A, gpu A" in caplog.text


def test_killed_training_ends_bit_equal(demos, tmp_path):
    """Six updates equal three, SIGKILL and the same command again, of the real policy."""
    flags = {"demos": 4, "validation": 2, "resolution": 24, "steps": 6, "batch": 2, "pairs": 1,
             "log_every": 1, "save_every": 3, "eval_every": 6,
             "data_dir": demos.path.parent}  # fmt: skip
    words = [x for k, v in flags.items() for x in ("--" + k.replace("_", "-"), str(v))]

    def until(folder, step):
        command = [sys.executable, "-m", "jaxcam.train", *words, "--run-dir", str(folder)]
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, cwd=tmp_path
        ) as process:
            deadline = time.monotonic() + 240
            while not (folder / "checkpoints" / str(step)).exists():
                assert process.poll() is None, process.stdout.read().decode()
                assert time.monotonic() < deadline
                time.sleep(0.01)
            process.kill()

    until(tmp_path / "whole", 6)
    until(tmp_path / "killed", 3)
    until(tmp_path / "killed", 6)
    assert (tmp_path / "killed" / "command.txt").read_text().count("\n") == 2
    assert_close(tmp_path / "killed", tmp_path / "whole", rtol=0)
    whole, killed = (losses(tmp_path / name) for name in ("whole", "killed"))
    assert killed == {step: loss for step, loss in whole.items() if step in killed}
    assert list(killed)[:3] == [1, 2, 3]


def test_jit_of_the_update_is_made_once(tmp_path):
    traces = []
    policy = tiny_training.policy()

    def counted(params, batch, key):
        traces.append(key)
        return policy.loss(params, batch, key)

    config = settings(tmp_path / "run", validation=0)
    with RunDir.open(config) as run:
        trainer = Trainer(config, tiny_training.dataset(),
                          dataclasses.replace(policy, loss=counted), Interrupt())  # fmt: skip
        trainer.fit([config], [run])
    assert len(traces) == 1
