"""Jobs: commands in order, here or where submitit sends them."""

import os
import signal
import sys
import threading
import time

import pytest
from small_grid import needs_submitit

from jaxcam.files.jsonl import read_jsonl
from jaxcam.runs.grid import progress_of, read_grid
from jaxcam.runs.jobs import PREEMPTED, Here, Job, Submitit


def python(code):
    return [sys.executable, "-c", code]


def test_commands_run_in_order_until_one_fails(tmp_path):
    log = tmp_path / "logs" / "log"
    job = Job([python("print(1)"), python("print(2); exit(7)"), python("print(3)")], log)
    assert job() == 7
    assert log.read_text() == "1\n2\n"
    assert Job([python("print(4)")], log)() == 0
    assert log.read_text() == "1\n2\n4\n"


def test_a_command_that_a_signal_killed_has_its_number(tmp_path):
    job = Job([python("import os; os.kill(os.getpid(), 9)")], tmp_path / "log")
    assert job() == -signal.SIGKILL


def test_stopping_ends_what_runs_and_starts_nothing_else(tmp_path):
    waits = python("import time; print('on', flush=True); time.sleep(60)")
    log = tmp_path / "log"
    here = Here(1)
    first = here.start("first", Job([waits, python("print('next')")], log))
    second = here.start("second", Job([python("print('second')")], tmp_path / "second"))
    deadline = time.monotonic() + 30
    while not (log.exists() and log.read_text()):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    threading.Timer(0.1, here.stop).start()
    assert first.result(30) == -signal.SIGTERM
    assert second.result(30) in PREEMPTED
    assert log.read_text() == "on\n"
    assert not (tmp_path / "second").exists()


@needs_submitit
@pytest.mark.filterwarnings("default")
def test_a_job_that_an_earlier_process_queued_is_found_again(tmp_path, monkeypatch):
    class Queued:
        def __init__(self, folder, number):
            self.number = number

        def done(self):
            return self.number == "8"

    monkeypatch.setattr("submitit.LocalJob", Queued)
    executor = Submitit("local", tmp_path, {})
    (tmp_path / "a.job").write_text("7")
    (tmp_path / "b.job").write_text("8")
    job = Job([[sys.executable, "-c", ""]], tmp_path / "log")
    assert executor.start("a", job).number == "7"
    assert executor.start("b", job).result() == 0  # that one had ended


@needs_submitit
@pytest.mark.filterwarnings("default")
def test_a_preempted_job_saves_and_is_queued_again(write, tmp_path, monkeypatch):
    monkeypatch.setenv("FAKE_SECONDS", "0.3")
    run = read_grid(write()).runs[0]
    job = Job(run.commands(), tmp_path / "log")
    first = Submitit("local", tmp_path / "submitit", {}).start(run.name, job)
    deadline = time.monotonic() + 30
    while not (run.folder / "metrics.jsonl").exists():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    (start,) = read_jsonl(run.folder / "starts.jsonl")
    os.kill(start["parent"], signal.SIGUSR2)  # what a cluster does before it takes the machine
    assert first.result() == 0
    assert progress_of(run).done
    trained = [row["step"] for row in read_jsonl(run.folder / "metrics.jsonl")]
    assert trained == [10, 20, 30, 40]  # the second start went on, nothing was done twice
    assert len(read_jsonl(run.folder / "starts.jsonl")) == 2
