"""TensorBoard and Weights & Biases: what they are given, and that they cannot stop a run."""

import json
import logging
import struct
import sys
import types

import pytest
from tiny_training import fit, settings

from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.files.jsonl import read_jsonl
from jaxcam.pipeline import train
from jaxcam.training.checkpoint import checkpoint_steps
from jaxcam.training.loggers import Loggers, check_loggers


def events(folder):
    """What TensorBoard's files hold: (step, name, value), and the steps that hide later ones."""
    event_pb2 = pytest.importorskip("tensorboardX.proto.event_pb2")
    scalars, purged = [], []
    for file in sorted(folder.glob("events.*"), key=lambda p: p.stat().st_mtime_ns):
        data = file.read_bytes()
        while data:  # records: length, its check sum, content, its check sum
            (length,) = struct.unpack("<Q", data[:8])
            event = event_pb2.Event.FromString(data[12 : 12 + length])
            scalars += [(event.step, v.tag, v.simple_value) for v in event.summary.value]
            if event.HasField("session_log"):
                purged.append(event.step)
            data = data[16 + length :]
    return scalars, purged


def test_tensorboard_gets_every_row(tmp_path):
    pytest.importorskip("tensorboardX")
    fit(settings(tmp_path, steps=3, log=("tensorboard",)))
    fit(settings(tmp_path, log=("tensorboard",)))
    scalars, purged = events(tmp_path / "tensorboard")
    rows = read_jsonl(tmp_path / "metrics.jsonl")
    wanted = [(r["step"], k, v) for r in rows for k, v in r.items() if k != "step"]
    assert sorted(scalars) == [(s, k, pytest.approx(v, rel=1e-6)) for s, k, v in sorted(wanted)]
    assert purged == [1, 4]


class FakeRun:
    def __init__(self, wandb, given):
        self.wandb, self.given, self.rows, self.finished = wandb, given, [], False

    def define_metric(self, name, step_metric):
        assert (name, step_metric) == ("*", "step")

    def log(self, row):
        self.wandb.calls += 1
        if self.wandb.calls == self.wandb.fails_at:
            raise ConnectionError("the hub is unreachable")
        self.rows.append(row)

    def finish(self):
        self.finished = True


@pytest.fixture
def wandb(monkeypatch):
    """Stands for the package: its runs, and the call at which it fails."""
    fake = types.ModuleType("wandb")
    fake.__spec__ = types.SimpleNamespace()
    fake.runs, fake.calls, fake.fails_at = [], 0, None

    def init(**given):
        fake.runs.append(FakeRun(fake, given))
        return fake.runs[-1]

    fake.init, fake.Settings = init, dict
    monkeypatch.setitem(sys.modules, "wandb", fake)
    return fake


def test_wandb_goes_on_with_the_same_run(wandb, tmp_path):
    fit(settings(tmp_path, steps=3, log=("wandb",)))
    fit(settings(tmp_path, log=("wandb",)))
    first, second = wandb.runs
    assert first.given["id"] == second.given["id"] == (tmp_path / "wandb.txt").read_text().strip()
    assert first.given["resume"] == "allow"
    assert first.given["config"]["batch"] == 12
    assert [r["step"] for r in first.rows + second.rows] == [*range(1, 7)]
    assert first.rows + second.rows == read_jsonl(tmp_path / "metrics.jsonl")
    assert first.finished
    assert second.finished


def test_the_run_has_its_name_before_anything_is_sent(wandb, tmp_path, monkeypatch):
    def init(**given):
        assert (tmp_path / "wandb.txt").read_text().strip() == given["id"]
        raise ConnectionError("no network")

    monkeypatch.setattr(wandb, "init", init)
    Loggers(("wandb",), tmp_path, TrainConfig(), 0)
    assert (tmp_path / "wandb.txt").exists()


def test_a_hub_that_fails_is_told_once_and_the_run_goes_on(wandb, tmp_path, caplog):
    wandb.fails_at = 3
    with caplog.at_level(logging.WARNING):
        fit(settings(tmp_path, log=("wandb",)))
    messages = [r.message for r in caplog.records if "wandb" in r.message]
    assert messages == ["wandb failed, the run goes on without it: the hub is unreachable"]
    assert [r["step"] for r in wandb.runs[0].rows] == [1, 2]
    assert len(read_jsonl(tmp_path / "metrics.jsonl")) == 6
    assert checkpoint_steps(tmp_path) == [*range(1, 7)]


def test_seeds_side_by_side_are_runs_of_their_own(wandb, tmp_path):
    fit(*(settings(tmp_path / s, seed=int(s), steps=3, log=("wandb",)) for s in "01"))
    assert len({run.given["id"] for run in wandb.runs}) == 2
    assert [run.given["name"] for run in wandb.runs] == ["0", "1"]
    assert all(run.given["reinit"] == "create_new" for run in wandb.runs)


def test_wandb_itself_without_a_network(tmp_path, monkeypatch):
    pytest.importorskip("wandb", reason="the extra `wandb` is not installed")
    monkeypatch.setenv("WANDB_MODE", "offline")
    fit(settings(tmp_path, steps=2, log=("wandb",)))
    fit(settings(tmp_path, steps=3, log=("wandb",)))
    offline = sorted((tmp_path / "wandb").glob("offline-run-*"))
    identity = (tmp_path / "wandb.txt").read_text().strip()
    assert len(offline) == 2
    assert all(p.name.endswith(identity) for p in offline)
    assert all(next(p.glob("*.wandb")).stat().st_size for p in offline)


@pytest.mark.parametrize("name", ["wandb", "tensorboard"])
def test_a_missing_package_is_told_before_anything_is_made(name, tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda package: None)
    with pytest.raises(ConfigError, match=rf"--log {name} needs .*pip install 'jaxcam\[{name}\]'"):
        train(TrainConfig(log=(name,), preset="laptop", run_dir=str(tmp_path / "run")))
    assert not (tmp_path / "run").exists()
    check_loggers(())


def test_loggers_are_no_part_of_a_run(wandb, tmp_path):
    fit(settings(tmp_path, steps=1))
    fit(settings(tmp_path, steps=2, log=("wandb",)))
    assert json.loads((tmp_path / "config.json").read_text())["log"] == ["wandb"]
