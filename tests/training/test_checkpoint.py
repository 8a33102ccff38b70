"""Checkpoints: exact round trip, and every fault that was seen or is to be feared, injected."""

import dataclasses
import logging
import os
import shutil
import signal
import subprocess
import sys
import textwrap
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from places import HELPERS
from tiny_checkpoints import (
    CONFIG,
    DAMAGES,
    ROOT,
    SIDE,
    STATS,
    Settings,
    assert_same,
    data_files,
    flip_byte,
    fresh,
    init,
    template,
    train,
)

import jaxcam.training.checkpoint
import jaxcam.training.side
from jaxcam.config.fields import to_json
from jaxcam.errors import CheckpointError, ConfigError
from jaxcam.models import PolicySpec
from jaxcam.models.policy import blank_stats
from jaxcam.runs.identity import read_config
from jaxcam.training.checkpoint import (
    Checkpoints,
    PolicyInputs,
    checkpoint_steps,
    load_policy_inputs,
    rebuild_policy,
)
from jaxcam.training.side import make_side
from jaxcam.training.state import init_state

# Orbax reads arrays side by side and closes its event loop at the first that fails; the others
# then complain from threads of their own.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")


def test_six_steps_equal_three_saved_restored_and_three(run):
    with Checkpoints(run / "checkpoints") as checkpoints:
        restored = checkpoints.restore_latest(template())
    assert int(restored.state.step) == 3
    assert_same(restored.state, train(fresh(), 3))
    assert_same(train(restored.state, 6), train(fresh(), 6))


def test_a_run_whose_optimizer_had_no_mask_goes_on(tmp_path):
    old = init_state(init, optax.adamw(1e-2), ROOT, ema=True)
    old = dataclasses.replace(old, step=jnp.int32(3), opt=jax.tree.map(lambda x: x + 1, old.opt))
    with Checkpoints(tmp_path / "checkpoints") as checkpoints:
        checkpoints.save(old, SIDE)
        restored = checkpoints.restore_latest(template()).state
    assert_same(restored.opt.inner_state, old.opt)
    assert_same(restored.params, old.params)
    assert int(train(restored, 4).step) == 4


def test_side_comes_back_exactly(run):
    with Checkpoints(run / "checkpoints") as checkpoints:
        side = checkpoints.restore_latest(template()).side
    assert side["seed"] == 0
    assert side["data"] == "abc"
    assert side["packages"]["jax"] == jax.__version__
    assert side["stats"]["action_mean"].dtype == np.float32
    np.testing.assert_array_equal(side["stats"]["action_mean"], STATS["action_mean"])
    assert side["stats"]["n"].dtype == np.int64


def test_policy_inputs_from_the_folder_alone(run):
    shutil.rmtree(run / "checkpoints" / "2" / "train")  # The optimizer is not even looked at.
    inputs = load_policy_inputs(run, step=2)
    assert inputs.step == 2
    assert inputs.config == CONFIG
    assert Settings(**inputs.settings) == Settings()
    assert Settings(**inputs.spec) == Settings(width=9)
    np.testing.assert_array_equal(inputs.stats["action_mean"], STATS["action_mean"])
    assert_same(inputs.params, train(fresh(), 2).ema)
    assert load_policy_inputs(run).step == 3


def test_policy_inputs_without_moving_average(tmp_path):
    with Checkpoints(tmp_path / "checkpoints") as checkpoints:
        checkpoints.save(state := fresh(ema=False), SIDE)
    assert_same(load_policy_inputs(tmp_path).params, state.params)


def test_no_such_checkpoint(run, tmp_path):
    with pytest.raises(CheckpointError, match=r"No checkpoint of step 9 .* Known: 1, 2, 3"):
        load_policy_inputs(run, step=9)
    with pytest.raises(CheckpointError, match="Train first"):
        load_policy_inputs(tmp_path / "nowhere")
    assert not (tmp_path / "nowhere").exists()
    with Checkpoints(tmp_path / "empty") as checkpoints:
        assert checkpoints.restore_latest(template()) is None


def test_keeps_the_newest_and_saves_a_step_once(tmp_path):
    with Checkpoints(tmp_path / "checkpoints", keep=2) as checkpoints:
        state = fresh()
        for step in (1, 2, 3, 3):
            state = train(state, step)
            checkpoints.save(state, SIDE)
        assert checkpoints.steps() == [2, 3]
    assert checkpoint_steps(tmp_path) == [2, 3]


def test_checkpoints_between_the_regular_ones_are_kept_until_the_next(tmp_path):
    config = dataclasses.replace(CONFIG, save_every=2)
    side = make_side(config, settings=Settings(), spec=Settings(), stats=STATS, data="abc")
    kept = []
    with Checkpoints(tmp_path / "checkpoints", keep=2) as checkpoints:
        state = fresh()
        for step in (2, 3, 4, 5, 6, 7):
            state = train(state, step)
            checkpoints.save(state, side)
            kept.append(checkpoints.steps())
    assert kept == [[2], [2, 3], [2, 4], [2, 4, 5], [4, 6], [4, 6, 7]]
    assert checkpoint_steps(tmp_path) == [4, 6, 7]


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_noticed_and_an_older_one_used(run, damage, caplog):
    damage(run)
    with caplog.at_level(logging.WARNING), Checkpoints(run / "checkpoints") as checkpoints:
        restored = checkpoints.restore_latest(template())
        assert "CHECKPOINT 3 IS DAMAGED" in caplog.text
        assert_same(restored.state, train(fresh(), 2))
        # The run goes on over the damaged step, which is kept aside.
        checkpoints.save(train(restored.state, 3), SIDE)
        assert checkpoints.steps() == [1, 2, 3]
        assert (run / "damaged" / "3-0").is_dir()
        assert_same(checkpoints.restore_latest(template()).state, train(fresh(), 3))


def test_damage_named_when_that_step_is_asked_for(run):
    flip_byte(data_files(run, 3, "ema")[-1])
    with pytest.raises(CheckpointError, match=r"Checkpoint 3 .* ema/\S+ has changed|cannot be rea"):
        load_policy_inputs(run, step=3)
    assert load_policy_inputs(run).step == 2
    assert checkpoint_steps(run) == [1, 2, 3]


def test_nothing_whole_is_an_error_that_lists_why(run):
    for step in (1, 2, 3):
        shutil.rmtree(run / "checkpoints" / str(step) / "manifest")
    with (
        Checkpoints(run / "checkpoints") as checkpoints,
        pytest.raises(CheckpointError, match=r"No checkpoint in .* is whole. 3: .*; 2: .*; 1: "),
    ):
        checkpoints.restore_latest(template())
    assert checkpoint_steps(run) == [1, 2, 3]


def test_a_disk_too_full_for_digests_does_not_lose_the_checkpoint(tmp_path, monkeypatch, caplog):
    def full(folder):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(jaxcam.training.checkpoint, "write_digests", full)
    with Checkpoints(tmp_path / "checkpoints") as checkpoints:
        checkpoints.save(train(fresh(), 1), SIDE)
        assert_same(checkpoints.restore_latest(template()).state, train(fresh(), 1))
    assert "Checkpoint 1 is whole, its files have no digests" in caplog.text


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda p: {**p, "w": p["w"].astype(jnp.float16)},
            r"params/w is float32 \(64, 5\), expecte",
        ),
        (lambda p: {**p, "w": p["w"][:3]}, r"params/w is float32 \(64, 5\), expected float32 \(3"),
        (lambda p: {**p, "more": p["w"]}, "params/more is missing, expected float32"),
        (lambda p: {"w": p["w"]}, r"params/deep/0/b is float32 \(5,\), expected nothing"),
    ],
)
def test_other_policy_is_refused(run, change, message):
    other = jax.eval_shape(lambda: dataclasses.replace(fresh(), params=change(fresh().params)))
    with (
        Checkpoints(run / "checkpoints") as checkpoints,
        pytest.raises(CheckpointError, match=message),
    ):
        checkpoints.restore_latest(other)
    assert checkpoint_steps(run) == [1, 2, 3]
    assert not (run / "damaged").exists()


def test_other_data_settings_or_convention_are_refused(run, monkeypatch):
    with Checkpoints(run / "checkpoints") as checkpoints:
        same = make_side(CONFIG, settings=Settings(), spec=Settings(9), stats=STATS, data="abc")
        assert checkpoints.restore_latest(template(), expect=same)
        with pytest.raises(CheckpointError, match=r"other data \('abc' -> 'xyz'\)"):
            checkpoints.restore_latest(template(), expect={**same, "data": "xyz"})
        other = make_side(CONFIG, settings=Settings(5), spec=Settings(9), stats={}, data="abc")
        with pytest.raises(CheckpointError, match=r"other settings \(width: 4 -> 5\)"):
            checkpoints.restore_latest(template(), expect=other)
    monkeypatch.setattr(jaxcam.training.side, "CONVENTION", 2)
    with pytest.raises(CheckpointError, match="conventions 1, this version of jaxcam has 2"):
        load_policy_inputs(run)


@pytest.mark.parametrize("part", ["settings", "spec"])
@pytest.mark.parametrize("edit", [{"zzz": 1}, {"chunk": "x"}, {"chunk": 0}, {"width": None}])
def test_settings_and_sizes_that_are_no_policys_are_refused(part, edit):
    spec = {"action_dim": 7, "proprio_dim": 9, "views": 1, "height": 16, "width": 16, "chunk": 4}
    given = {"settings": {}, "spec": spec, part: {**(spec if part == "spec" else {}), **edit}}
    inputs = PolicyInputs(CONFIG, given["settings"], given["spec"], {}, {}, 3)
    with pytest.raises(CheckpointError, match="Checkpoint 3 is of another version"):
        rebuild_policy(inputs)


def test_parameters_that_are_no_policys_are_refused():
    """Also under a right seal: an export of none would be a checkpoint without arrays."""
    settings = {"chunk": 4, "execute": 2, "layers": 1, "width": 16, "heads": 2, "hidden": 8}
    spec = {"action_dim": 7, "proprio_dim": 9, "views": 1, "height": 32, "width": 32, "chunk": 4}
    stats = blank_stats(PolicySpec(**spec))
    with pytest.raises(CheckpointError, match=r"another policy: .* is missing, expected float32"):
        rebuild_policy(PolicyInputs(CONFIG, settings, spec, stats, {}, 3))


def test_other_packages_are_reported(run, monkeypatch, caplog):
    monkeypatch.setattr(jaxcam.training.side, "package_versions", lambda: {"jax": "0.0.1"})
    with caplog.at_level(logging.WARNING):
        load_policy_inputs(run)
    assert f"jax {jax.__version__} -> 0.0.1" in caplog.text


def test_too_little_space_is_refused_before_writing(run, monkeypatch):
    # Faked free space: filling a real disk is done below, where the system permits.
    usage = SimpleNamespace(free=1000)
    monkeypatch.setattr(jaxcam.training.checkpoint.shutil, "disk_usage", lambda path: usage)
    with Checkpoints(run / "checkpoints") as checkpoints:
        with pytest.raises(CheckpointError, match=r"No space .* 4 .* last whole checkpoint is 3"):
            checkpoints.save(train(fresh(), 4), SIDE)
        assert checkpoints.steps() == [1, 2, 3]


@pytest.fixture
def small_disk(tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(disk)]
    if os.geteuid() or subprocess.run(command, capture_output=True).returncode:
        pytest.skip("mounting a small file system needs root")
    yield disk
    subprocess.run(["umount", "--lazy", str(disk)], check=True)


@pytest.mark.parametrize("check_space", [True, False])
def test_real_disk_full(small_disk, monkeypatch, check_space):
    if not check_space:  # Space that vanishes between the check and the write.
        monkeypatch.setattr(jaxcam.training.checkpoint, "SPACE_FACTOR", 0)
    big = fresh()
    big = dataclasses.replace(big, params={**big.params, "big": jnp.asarray(np.random.default_rng(
        0).normal(size=(500, 500)).astype(np.float32))})  # fmt: skip
    with Checkpoints(small_disk / "checkpoints") as checkpoints:
        checkpoints.save(big, SIDE)
        later = dataclasses.replace(big, step=jnp.int32(1))
        pattern = "No space" if check_space else "could not be written"
        with pytest.raises(CheckpointError, match=f"{pattern}.*last whole checkpoint is 0"):
            checkpoints.save(later, SIDE)
        assert [p.name for p in (small_disk / "checkpoints").iterdir()] == ["0"]
        assert_same(checkpoints.restore_latest(jax.eval_shape(lambda: big)).state, big)


def test_kill_while_saving(tmp_path):
    """A writer killed at any moment leaves whole checkpoints only."""
    script = textwrap.dedent("""
        import sys, dataclasses
        import jax.numpy as jnp
        sys.path.insert(0, sys.argv[1])
        from jaxcam.training.checkpoint import Checkpoints
        from tiny_checkpoints import SIDE, fresh
        big = dataclasses.replace(fresh(), ema={"big": jnp.ones((1000, 1000))})
        with Checkpoints(sys.argv[2], keep=3) as checkpoints:
            for step in range(1, 10000):
                ema = {"big": big.ema["big"] * step}
                state = dataclasses.replace(big, step=jnp.int32(step), ema=ema)
                print("saving", flush=True)
                checkpoints.save(state, SIDE)
    """)
    folder = tmp_path / "checkpoints"
    for delay in (0.01, 0.04):
        command = [sys.executable, "-c", script, str(HELPERS), str(folder)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            for _ in range(len(checkpoint_steps(tmp_path)) + 3):
                assert process.stdout.readline()
            with pytest.raises(subprocess.TimeoutExpired):
                process.wait(delay)
            process.send_signal(signal.SIGKILL)
        with Checkpoints(folder) as checkpoints:
            big = dataclasses.replace(fresh(), ema={"big": jnp.ones((1000, 1000))})
            state = checkpoints.restore_latest(jax.eval_shape(lambda big=big: big)).state
            assert (state.ema["big"] == state.step).all()
            assert int(state.step) == checkpoints.steps()[-1]
        assert not list(folder.glob("*tmp*"))
    assert not (tmp_path / "damaged").exists()


def test_stale_half_written_checkpoints_are_removed(run):
    stale = run / "checkpoints" / "4.orbax-checkpoint-tmp"
    (stale / "params").mkdir(parents=True)
    with Checkpoints(run / "checkpoints") as checkpoints:
        assert not stale.exists()
        assert checkpoints.steps() == [1, 2, 3]


@pytest.mark.parametrize("changed", [{"lr": 0.5}, {"conditioning": "none"}, {"seed": 4}])
def test_a_config_that_is_not_the_checkpoints_is_refused(run, changed):
    own = dataclasses.replace(CONFIG, pairs=7, data_dir="elsewhere")  # training stays as it was
    (run / "config.json").write_text(to_json(own))
    assert load_policy_inputs(run).step == 3
    assert read_config(run) == own
    (run / "config.json").write_text(to_json(dataclasses.replace(CONFIG, **changed)))
    (name,) = changed
    for read in (load_policy_inputs, read_config):
        with pytest.raises(
            ConfigError, match=rf"not what checkpoint 1 was trained with \({name}: "
        ):
            read(run)
