"""Run folders: locks, configurations, and what is refused."""

import logging
import os
import signal
import socket
import subprocess
import sys
import textwrap

import numpy as np
import pytest
from rights import no_rights

import jaxcam.runs.environment
from jaxcam.config.fields import from_json
from jaxcam.config.train import TrainConfig
from jaxcam.errors import CheckpointError, ConfigError
from jaxcam.files.jsonl import read_jsonl
from jaxcam.runs.environment import package_versions
from jaxcam.runs.folder import RunDir
from jaxcam.runs.identity import resolve


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """The tests of this file do not need the devices, so JAX is not started."""
    monkeypatch.setattr(jaxcam.runs.environment, "environment", package_versions)


def config(folder, **changes):
    settings = {"steps": 100, "run_dir": str(folder), **changes}
    return resolve(TrainConfig(**settings), accelerator=False)


def contents(folder):
    return {p.name: p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_new_folder_holds_what_made_it(tmp_path):
    folder = tmp_path / "runs" / "a"
    with RunDir.open(config(folder), command=["train", "--task", "a b"]) as run:
        assert run.path == folder
        assert from_json(TrainConfig, (folder / "config.json").read_text()) == config(folder)
        assert (folder / "command.txt").read_text().endswith("  train --task 'a b'\n")
        assert f"numpy {np.__version__}" in (folder / "env.txt").read_text().splitlines()
        assert f"pid {os.getpid()} on {socket.gethostname()}" in (folder / "lock").read_text()
    assert (folder / "lock").read_text() == ""


def test_same_configuration_continues(tmp_path, caplog):
    with RunDir.open(config(tmp_path), command=["one"]) as run:
        run.log({"step": 1})
    with RunDir.open(config(tmp_path, pairs=9, save_every=7), command=["two"]) as run:
        assert read_jsonl(run.metrics) == [{"step": 1}]
    assert "pairs: 50 -> 9" in caplog.text
    assert from_json(TrainConfig, (tmp_path / "config.json").read_text()).pairs == 9
    lines = (tmp_path / "command.txt").read_text().splitlines()
    assert [line.split("  ")[1] for line in lines] == ["one", "two"]


def test_folder_of_another_configuration_is_refused_and_untouched(tmp_path):
    RunDir.open(config(tmp_path)).close()
    before = contents(tmp_path)
    with pytest.raises(ConfigError, match=r"(?s)conditioning: 'keypoints' -> 'none'\n.*lr: .* 0.2"):
        RunDir.open(config(tmp_path, conditioning="none", lr=0.2))
    assert contents(tmp_path) == before
    RunDir.open(config(tmp_path)).close()


def test_moved_folder_continues(tmp_path):
    RunDir.open(config(tmp_path / "a")).close()
    (tmp_path / "a").rename(tmp_path / "b")
    with RunDir.open(config(tmp_path / "b")) as run:
        assert len((run.path / "command.txt").read_text().splitlines()) == 2


def test_damaged_or_missing_configuration(tmp_path):
    RunDir.open(config(tmp_path)).close()
    (tmp_path / "config.json").write_text('{"task": "li')
    with pytest.raises(ConfigError, match="not JSON"):
        RunDir.open(config(tmp_path))
    (tmp_path / "config.json").unlink()
    (tmp_path / "checkpoints" / "3").mkdir(parents=True)
    with pytest.raises(ConfigError, match=r"has checkpoints, .* but no config\.json"):
        RunDir.open(config(tmp_path))
    assert not (tmp_path / "config.json").exists()


HOLDER = """
    import sys, time, jaxcam.runs.environment, jaxcam.runs.folder
    from jaxcam.config.train import TrainConfig
    from jaxcam.runs.identity import resolve
    jaxcam.runs.environment.environment = jaxcam.runs.environment.package_versions
    config = resolve(TrainConfig(steps=100, run_dir=sys.argv[1]), accelerator=False)
    with jaxcam.runs.folder.RunDir.open(config):
        print("open", flush=True)
        time.sleep(60)
"""


def test_lock_of_a_live_process_and_of_a_killed_one(tmp_path, caplog):
    command = [sys.executable, "-c", textwrap.dedent(HOLDER), str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "open\n"
        before = contents(tmp_path)
        with pytest.raises(ConfigError, match=f"in use by pid {holder.pid} on "):
            RunDir.open(config(tmp_path))
        assert contents(tmp_path) == before
        holder.send_signal(signal.SIGKILL)
        holder.wait()
    with caplog.at_level(logging.WARNING):
        RunDir.open(config(tmp_path)).close()
    assert f"ended without closing it (pid {holder.pid}" in caplog.text


def test_lock_within_one_process(tmp_path):
    with RunDir.open(config(tmp_path)), pytest.raises(ConfigError, match="in use by pid"):
        RunDir.open(config(tmp_path))


def test_no_permission(tmp_path):
    folder = tmp_path / "read-only"
    folder.mkdir(mode=0o555)
    within, itself = config(folder / "run"), config(folder)
    with no_rights():
        with pytest.raises(
            ConfigError, match=r"Cannot write to the run folder .*: Permission denied"
        ):
            RunDir.open(within)
        with pytest.raises(
            ConfigError, match=r"Cannot write to the run folder .*: Permission denied"
        ):
            RunDir.open(itself)


def test_run_folder_that_is_a_file(tmp_path):
    (tmp_path / "run").write_text("mine")
    with pytest.raises(ConfigError, match="Cannot write to the run folder"):
        RunDir.open(config(tmp_path / "run"))
    with pytest.raises(ConfigError, match="Cannot write to the run folder"):
        RunDir.open(config(tmp_path / "run" / "deeper"))
    assert (tmp_path / "run").read_text() == "mine"


def test_no_space(tmp_path):
    # Asking for more than any disk has tests the real path: nothing is faked.
    with pytest.raises(ConfigError, match="No space for a run"):
        RunDir.open(config(tmp_path / "run"), min_free=10**18)
    assert not contents(tmp_path)


def test_rewind_drops_what_is_written_again(tmp_path):
    with RunDir.open(config(tmp_path)) as run:
        run.rewind(0)
        for step in (1, 2, 2, 3):
            run.log({"step": step, "loss": 1.0})
        run.rewind(2)
        assert [row["step"] for row in read_jsonl(run.metrics)] == [1, 2, 2]


def test_a_folder_with_files_of_others_is_left_alone(tmp_path):
    (tmp_path / "report.html").write_text("mine")
    with pytest.raises(ConfigError, match=r"has report.html but no config\.json"):
        RunDir.open(config(tmp_path))
    assert (tmp_path / "report.html").read_text() == "mine"


def test_a_folder_that_is_renamed_while_its_run_trains(tmp_path):
    with RunDir.open(config(tmp_path / "run")) as run:
        run.check_there()
        (tmp_path / "run").rename(tmp_path / "renamed")
        with pytest.raises(CheckpointError, match="was renamed, moved or deleted"):
            run.check_there()
    assert not (tmp_path / "run").exists()
