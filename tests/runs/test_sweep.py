"""Runs of a grid: what is run of them, and what survives."""

import functools
import io
import os
import signal
import subprocess
import sys
import threading
import time

import pytest
from rich.console import Console
from small_grid import SMALL, needs_submitit

from jaxcam.config.commands import SweepConfig
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.files.jsonl import append_jsonl, read_jsonl
from jaxcam.files.locks import NamedLock
from jaxcam.runs import sweep
from jaxcam.runs.grid import progress_of, read_grid
from jaxcam.runs.jobs import Here, Submitit


def run(plan, executor=None, jobs=2, retries=2):
    console = Console(file=io.StringIO())
    entries = sweep.sweep(plan, executor or Here(jobs), console, jobs=jobs, retries=retries)
    return {e.run.name: e for e in entries}, console.file.getvalue()


def starts(entry):
    return len(read_jsonl(entry.run.folder / "starts.jsonl"))


def test_what_is_done_is_skipped(write):
    plan = read_grid(write())
    entries, said = run(plan)
    assert {e.state for e in entries.values()} == {"done"}
    assert [starts(e) for e in entries.values()] == [1, 1, 1, 1]
    assert said.count("4 of 4 rollouts, success 50.0 %") == 4
    entries, _ = run(plan)
    assert [starts(e) for e in entries.values()] == [1, 1, 1, 1]
    rows = plan.runs[0].folder / "eval" / "rows.jsonl"
    rows.write_text("".join(rows.read_text().splitlines(keepends=True)[:-1]))
    assert progress_of(plan.runs[0]).rollouts == 3
    entries, _ = run(plan)
    assert [starts(e) for e in entries.values()] == [2, 1, 1, 1]


def test_rows_of_two_widths_do_not_make_up_for_each_other(write):
    plan = read_grid(write())
    whole, *_ = plan.runs
    file = whole.folder / "eval" / "rows.jsonl"
    file.parent.mkdir(parents=True)
    said = {"step": 40, "split": "test", "status": "ok", "success": True}
    append_jsonl(file, *({**said, "pair": p, "width": 9} for p in range(3)))
    append_jsonl(file, *({**said, "pair": p, "width": 2} for p in range(2, 4)))
    standing = progress_of(whole)
    assert (standing.rollouts, standing.done) == (3, False)
    append_jsonl(file, {**said, "pair": 0, "width": 2}, {**said, "pair": 1, "width": 2})
    assert progress_of(whole).done


def test_rows_of_another_run_are_no_progress(write):
    plan = read_grid(write())
    run(plan)
    rows = plan.runs[0].folder / "eval" / "rows.jsonl"
    append_jsonl(rows, {"step": 40, "split": "test", "pair": 0, "status": "ok", "success": False})
    with pytest.raises(DatasetError, match="not of this run"):
        progress_of(plan.runs[0])


def test_the_papers_protocol_evaluates_the_last_ten_checkpoints(write):
    text = SMALL.replace("steps: 40", "steps: 120").replace("pairs: 4", "keep: 11")
    plan = read_grid(write(text.replace("title: small", "protocol: paper")))
    assert plan.runs[0].steps == [*range(120, 20, -10)]
    entries, _ = run(plan)
    assert {(e.state, e.progress.rollouts) for e in entries.values()} == {("done", 500)}


def test_a_killed_run_goes_on_and_a_broken_one_is_told(write, monkeypatch):
    monkeypatch.setenv("FAKE_KILLED", "0")
    monkeypatch.setenv("FAKE_FAILS", "1")
    entries, said = run(read_grid(write()))
    states = {(e.run.config.seed, e.state, e.starts) for e in entries.values()}
    assert states == {(0, "done", 2), (1, "failed", 1)}
    assert "exit code 2: ConfigError: nothing works here" in said
    assert "stopped (-9), starting again" in said


def test_a_run_that_is_always_killed_is_given_up(write, monkeypatch):
    monkeypatch.setenv("FAKE_KILLED", "0")
    entries, _ = run(read_grid(write()), retries=0)
    assert [e.state for e in entries.values()].count("failed") == 2


def test_a_signal_lets_the_runs_save(write, monkeypatch):
    monkeypatch.setenv("FAKE_SECONDS", "0.3")
    plan = read_grid(write())

    def interrupt():
        while not (plan.runs[0].folder / "metrics.jsonl").exists():
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=interrupt, daemon=True).start()
    with pytest.raises(KeyboardInterrupt):
        run(plan, jobs=1)
    saved = progress_of(plan.runs[0]).step
    assert 0 < saved < 40
    time.sleep(0.7)
    assert progress_of(plan.runs[0]).step == saved  # it has ended
    assert not plan.runs[1].folder.exists()  # what waited was not started
    monkeypatch.setenv("FAKE_SECONDS", "0")
    entries, _ = run(plan)
    assert {e.state for e in entries.values()} == {"done"}


@pytest.mark.parametrize("line", ["{nonsense", "[1]", '{"step": "many"}'])
def test_a_run_whose_records_are_damaged_does_not_stop_the_others(write, line):
    plan = read_grid(write())
    damaged = plan.runs[1].folder / "metrics.jsonl"
    damaged.parent.mkdir(parents=True)
    damaged.write_text(line + "\n")
    entries, said = run(plan)
    assert [e.state for e in entries.values()] == ["done", "failed", "done", "done"]
    assert "metrics.jsonl" in entries[plan.runs[1].name].reason
    assert f"failed  {plan.runs[1].name}" in said
    assert damaged.read_text() == line + "\n"


def test_a_run_that_an_orphan_trains_is_waited_for(write):
    """A sweep that was killed leaves its child; the next one does not call its run failed."""
    plan = read_grid(write())
    folder = plan.runs[0].folder
    folder.mkdir(parents=True)
    orphan = NamedLock(folder / "lock")
    orphan.take()
    said = []

    def end():
        time.sleep(0.5)
        said.append((folder / "starts.jsonl").exists())
        orphan.free()

    threading.Thread(target=end, daemon=True).start()
    entries, _ = run(plan)
    assert said == [False]
    assert {e.state for e in entries.values()} == {"done"}
    assert [starts(e) for e in entries.values()] == [1, 1, 1, 1]


@needs_submitit
@pytest.mark.filterwarnings("default")  # submitit's own
def test_submitit_runs_the_same_jobs_and_finds_them_again(write, tmp_path):
    plan = read_grid(write())
    executor = functools.partial(Submitit, "local", tmp_path / "submitit")
    entries, _ = run(plan, executor({}))
    assert {(e.state, starts(e)) for e in entries.values()} == {("done", 1)}
    assert len(list((tmp_path / "submitit").glob("*.job"))) == 4
    with pytest.raises(ConfigError, match=r"slurm: .*timeout_mins"):
        executor({"timeout_mins": 3})


def test_the_table_has_room_for_what_matters(write):
    plan = read_grid(write())
    entries, _ = run(plan)
    several = list(entries.values())
    several[3].state, several[3].reason = "failed", "exit code 2"
    console = Console(file=io.StringIO(), width=150)
    console.print(sweep.table(plan, several, 10))
    shown = console.file.getvalue()
    assert shown.index("failed (exit code 2)") < shown.index("done")
    assert "1 failed, 3 done" in shown


def test_list_prints_commands_and_starts_nothing(tmp_path):
    path = tmp_path / "grid.yaml"
    path.write_text(SMALL.format(folder=tmp_path))
    done = subprocess.run(
        [sys.executable, "-m", "jaxcam.sweep", str(path), "--list"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.count("python -m jaxcam.train --preset laptop --steps 40") == 4
    assert done.stdout.count(": waiting") == 4
    assert not (tmp_path / "runs").exists()


def test_list_says_why_a_run_cannot_go_on(write):
    path = write()
    folder = read_grid(path).runs[0].folder
    folder.mkdir(parents=True)
    (folder / "config.json").write_text("{")
    console = Console(file=io.StringIO(), width=500)
    assert sweep.main(SweepConfig(str(path), list=True), console) == 0
    (line,) = [x for x in console.file.getvalue().splitlines() if ": failed" in x]
    assert "is not JSON" in line
