"""Run folders: locks, configurations, records that survive crashes, and interruptions."""

import json
import logging
import os
import shutil
import signal
import socket
import subprocess
import sys
import textwrap
import threading

import numpy as np
import pytest

import jaxcam.runs.folder
from jaxcam.config.fields import from_json
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.files.jsonl import append_jsonl, read_jsonl, write_atomically
from jaxcam.runs.environment import git_revision, package_versions
from jaxcam.runs.folder import RunDir
from jaxcam.runs.identity import resolve
from jaxcam.runs.interrupts import interrupts


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """The tests of this file do not need the devices, so JAX is not started."""
    monkeypatch.setattr(jaxcam.runs.folder, "environment", package_versions)


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
    with pytest.raises(ConfigError, match=r"has checkpoints but no config\.json"):
        RunDir.open(config(tmp_path))
    assert not (tmp_path / "config.json").exists()


def test_other_environment_is_reported(tmp_path, monkeypatch, caplog):
    RunDir.open(config(tmp_path)).close()
    monkeypatch.setattr(jaxcam.runs.folder, "environment", lambda: {"numpy": "0.1"})
    with caplog.at_level(logging.WARNING):
        RunDir.open(config(tmp_path)).close()
    assert "not bit-exact: now numpy 0.1" in caplog.text
    assert (tmp_path / "env.txt").read_text() == "numpy 0.1\n"


HOLDER = """
    import sys, time, jaxcam.runs.folder
    from jaxcam.config import TrainConfig, resolve
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


@pytest.fixture
def read_only(tmp_path):
    """A folder this process may not write to; root gives its rights up for the test."""
    folder = tmp_path / "read-only"
    folder.mkdir(mode=0o555)
    was_root = os.geteuid() == 0
    if was_root:
        os.seteuid(65534)
    yield folder
    if was_root:
        os.seteuid(0)


def test_no_permission(read_only):
    with pytest.raises(ConfigError, match=r"Cannot write to the run folder .*: Permission denied"):
        RunDir.open(config(read_only / "run"))
    with pytest.raises(ConfigError, match=r"Cannot write to the run folder .*: Permission denied"):
        RunDir.open(config(read_only))


def test_run_folder_that_is_a_file(tmp_path):
    (tmp_path / "run").write_text("mine")
    with pytest.raises(ConfigError, match="Cannot write to the run folder"):
        RunDir.open(config(tmp_path / "run"))
    with pytest.raises(ConfigError, match="Cannot write to the run folder"):
        RunDir.open(config(tmp_path / "run" / "deeper"))
    assert (tmp_path / "run").read_text() == "mine"


def test_no_space(tmp_path, monkeypatch):
    # Asking for more than any disk has tests the real path: nothing is faked.
    with pytest.raises(ConfigError, match="No space for a run"):
        RunDir.open(config(tmp_path / "run"), min_free=10**18)
    assert not contents(tmp_path)
    full = "/dev/full"  # Here every write really fails for want of space.
    if os.path.exists(full):
        with pytest.raises(OSError, match="No space left"):
            append_jsonl(full, {"step": 1})


def test_jsonl_round_trip(tmp_path):
    path = tmp_path / "rows.jsonl"
    assert read_jsonl(path) == []
    append_jsonl(path, {"a": np.float32(0.5), "b": [1, "ä\n"]})
    append_jsonl(path, {"c": np.arange(2)}, {"d": np.bool_(True)}, fsync=True)
    append_jsonl(path)
    assert read_jsonl(path) == [{"a": 0.5, "b": [1, "ä\n"]}, {"c": [0, 1]}, {"d": True}]
    assert len(path.read_text().splitlines()) == 3


@pytest.mark.parametrize("torn", [b'{"step": 3, "lo', b'{"step": 3}', b"\x80", b"x" * 200_000])
@pytest.mark.parametrize("whole", [b"", b'{"step": 1}\n{"step": 2}\n'])
def test_torn_last_line_is_ignored_and_cut(tmp_path, torn, whole):
    path = tmp_path / "rows.jsonl"
    path.write_bytes(whole + torn)
    rows = [json.loads(line) for line in whole.splitlines()]
    assert read_jsonl(path) == rows
    append_jsonl(path, {"step": 4})
    assert read_jsonl(path) == [*rows, {"step": 4}]
    assert path.read_bytes().startswith(whole)


def test_damage_before_the_last_line_is_an_error(tmp_path):
    path = tmp_path / "rows.jsonl"
    path.write_text('{"step": 1}\n{"st\n{"step": 3}\n')
    with pytest.raises(DatasetError, match=r"rows\.jsonl, line 2, is damaged"):
        read_jsonl(path)


def test_writers_killed_while_appending_leave_whole_rows(tmp_path):
    path = tmp_path / "rows.jsonl"
    script = textwrap.dedent("""
        import sys
        from jaxcam.rundir import append_jsonl, read_jsonl
        start = len(read_jsonl(sys.argv[1]))
        for i in range(start, 10**9):
            append_jsonl(sys.argv[1], {"i": i, "text": "x" * 5000})
            if i == start + 20: print("going", flush=True)
    """)
    for _ in range(2):
        command = [sys.executable, "-c", script, str(path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as writer:
            assert writer.stdout.readline()
            writer.kill()
    rows = read_jsonl(path)
    assert len(rows) > 40
    assert [row["i"] for row in rows] == list(range(len(rows)))


def test_rewind_drops_what_is_written_again(tmp_path):
    with RunDir.open(config(tmp_path)) as run:
        run.rewind(0)
        for step in (1, 2, 2, 3):
            run.log({"step": step, "kind": "train"})
        run.rewind(2)
        assert [row["step"] for row in read_jsonl(run.metrics)] == [1, 2, 2]


def test_write_atomically_keeps_the_old_content_on_failure(tmp_path, monkeypatch):
    path = tmp_path / "config.json"
    write_atomically(path, "old")

    def fail(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(jaxcam.runs.folder.os, "fsync", fail)
    with pytest.raises(OSError, match="No space"):
        write_atomically(path, "new")
    assert path.read_text() == "old"


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_first_signal_is_a_flag(number, code, capfd):
    before = signal.getsignal(number)
    with interrupts() as interrupt:
        assert not interrupt
        assert interrupt.exit_code == 0
        signal.raise_signal(number)
        assert interrupt
        assert interrupt.exit_code == code
    assert signal.getsignal(number) is before
    assert "Stopping after this update" in capfd.readouterr().err


@pytest.mark.parametrize("second", [signal.SIGINT, signal.SIGTERM])
def test_second_signal_stops_at_once(second):
    script = textwrap.dedent("""
        import time
        from jaxcam.rundir import interrupts
        with interrupts() as interrupt:
            print("ready", flush=True)
            while not interrupt: time.sleep(0.01)
            print("saving", flush=True)
            time.sleep(60)
    """)
    command = [sys.executable, "-c", script]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout.readline() == b"ready\n"
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == b"saving\n"
        process.send_signal(second)
        assert process.wait(10) == -second


def test_signal_handlers_need_the_main_thread():
    caught = []

    def enter():
        try:
            with interrupts():
                pass
        except ValueError as error:
            caught.append(error)

    thread = threading.Thread(target=enter)
    thread.start()
    thread.join()
    assert caught


def test_git_revision_only_of_our_own_checkout(tmp_path, monkeypatch):
    git = shutil.which("git")
    if git is None:
        pytest.skip("git is not installed")
    subprocess.run([git, "init", "-q", str(tmp_path)], check=True)
    monkeypatch.setattr(jaxcam.runs.folder, "__file__", str(tmp_path / "rundir.py"))
    (tmp_path / "rundir.py").write_text("")
    assert git_revision() is None
    who = ["-c", "user.name=x", "-c", "user.email=x@example.org"]
    subprocess.run([git, "-C", str(tmp_path), "add", "rundir.py"], check=True)
    subprocess.run([git, "-C", str(tmp_path), *who, "commit", "-qm", "x"], check=True)
    (tmp_path / "rundir.py").write_text("changed\n")
    revision = git_revision()
    assert len(revision.splitlines()[0]) == 40
    assert "+changed" in revision
