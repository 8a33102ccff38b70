"""Several devices and several processes: the same results as one, and one that writes."""

import json
import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
import tiny_training

from jaxcam.devices import data_mesh, gathered, joined, part, stacked
from jaxcam.errors import ConfigError
from jaxcam.files.jsonl import read_jsonl
from jaxcam.training.digests import read_all

SCRIPT = Path(tiny_training.__file__)


def start(what, folder, **variables):
    return subprocess.Popen(
        [sys.executable, str(SCRIPT), what, str(folder)], stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, text=True, env={**os.environ, **variables},
    )  # fmt: skip


def together(what, folder):
    """Two processes on this machine: exit codes and words."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    variables = {"JAX_COORDINATOR_ADDRESS": f"127.0.0.1:{port}", "JAX_NUM_PROCESSES": "2"}
    variables["JAX_ENABLE_COMPILATION_CACHE"] = "false"  # neither leans on what the other compiled
    both = [start(what, folder, **variables, JAX_PROCESS_ID=str(i)) for i in range(2)]
    words = [process.communicate(timeout=240)[0] for process in both]
    return [process.returncode for process in both], words


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """Folder of the run on one device."""
    folder = tmp_path_factory.mktemp("alone") / "run"
    tiny_training.fit(tiny_training.settings(folder))
    return folder


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Folder of what two processes did, and what each found."""
    folder = tmp_path_factory.mktemp("pair")
    codes, words = together("two", folder)
    assert codes == [0, 0], words
    return folder, [json.loads((folder / f"record-{i}.json").read_text()) for i in range(2)]


def assert_close(run, other):
    """Every array of every checkpoint, and every row of metrics."""
    for step in range(1, 7):
        here, there = (read_all(r / "checkpoints" / str(step))[1] for r in (run, other))
        assert here.keys() == there.keys()
        for name in here:
            np.testing.assert_allclose(here[name], there[name], rtol=1e-5, atol=1e-5, err_msg=name)
    rows, others = (read_jsonl(r / "metrics.jsonl") for r in (run, other))
    for row, same in zip(rows, others, strict=True):
        assert {**row, "seconds": 0} == pytest.approx({**same, "seconds": 0}, rel=1e-5, abs=1e-6)


def test_four_devices_equal_one(alone, tmp_path):
    flags = "--xla_force_host_platform_device_count=4"
    process = start("one", tmp_path, XLA_FLAGS=flags)
    words, _ = process.communicate(timeout=240)
    assert process.returncode == 0, words
    assert_close(alone, tmp_path / "run")
    # What four devices saved goes on on one.
    (state,) = tiny_training.fit(tiny_training.settings(tmp_path / "run", steps=7))
    shutil.copytree(alone, tmp_path / "copy")
    (same,) = tiny_training.fit(tiny_training.settings(tmp_path / "copy", steps=7))
    np.testing.assert_allclose(state.params["w"], same.params["w"], rtol=1e-5, atol=1e-5)


def test_two_processes_equal_one(alone, pair):
    folder, records = pair
    assert [f["shard"] for f in records] == [[0, 2], [1, 2]]
    assert [f["devices"] for f in records] == [2, 2]
    assert_close(alone, folder / "run")
    assert records[0]["w"] == records[1]["w"]
    assert [f["step"] for f in records] == [6, 6]


def test_only_the_first_process_writes(pair):
    folder, _ = pair
    assert not (folder / "elsewhere").exists()
    assert len((folder / "run" / "command.txt").read_text().splitlines()) == 2


def test_a_signal_to_one_process_stops_both_after_saving(pair):
    folder, records = pair
    assert [f["stopped"] for f in records] == [1, 1]
    assert [p.name for p in (folder / "stopped" / "checkpoints").iterdir()] == ["1"]


def test_processes_share_pairs_without_a_lost_or_doubled_row(pair):
    folder, records = pair
    rows = read_jsonl(folder / "eval" / "rows.jsonl")
    assert [r["pair"] for r in rows if r["status"] == "ok"] == [0, 3, 1, 4, 5, 6]
    assert [r["pair"] for r in rows if r["status"] == "error"] == [1, 2, 2]
    assert sorted(records[0]["ran"] + records[1]["ran"]) == [0, 1, 1, 2, 2, 3, 4, 5, 6]
    assert all(f["ran"] for f in records)
    assert records[0]["estimate"] == records[1]["estimate"] == [0.5, 6]


def test_processes_with_different_data_are_refused(pair):
    _, records = pair
    for f in records:
        assert "different demonstrations: process 0 has abc, process 1 has xyz" in f["different"]


def test_one_that_fails_ends_the_other(tmp_path):
    codes, words = together("fail", tmp_path)
    assert codes[0] == 3, words
    assert "nothing there" in words[0]
    assert codes[1] != 0


def test_processes_that_cannot_be_found(monkeypatch):
    for name in ("JAX_COORDINATOR_ADDRESS", "SLURM_JOB_ID", "OMPI_MCA_orte_hnp_uri"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ConfigError, match="JAX_COORDINATOR_ADDRESS"), joined(True):
        pass


def test_devices_divide_the_batch(monkeypatch, caplog):
    class Device:
        def __init__(self, index):
            self.id, self.process_index = index % 8, index // 8

    monkeypatch.setattr(jax, "local_device_count", lambda: 8)
    monkeypatch.setattr(jax, "devices", lambda: [Device(i) for i in range(16)])
    monkeypatch.setattr(jax, "process_count", lambda: 2)
    monkeypatch.setattr("jaxcam.devices.Mesh", lambda devices, axes: devices)
    assert len(data_mesh(64)) == 16
    assert not caplog.text
    chosen = data_mesh(70)  # the paper's batch
    assert [(d.process_index, d.id) for d in chosen] == [(p, i) for p in (0, 1) for i in range(7)]
    assert "shared by 7 of the 8 devices of each process; a multiple of 16" in caplog.text
    with pytest.raises(ConfigError, match="35 samples at once cannot be shared by 2 processes"):
        data_mesh(35)


def test_one_process_talks_to_itself():
    assert gathered({"a": [1]}) == [{"a": [1]}]
    trees = [{"a": np.arange(3) + i} for i in range(2)]
    both = stacked(trees)
    assert part(both, 1, 2)["a"].tolist() == [1, 2, 3]
    assert stacked(trees[:1]) is trees[0]
