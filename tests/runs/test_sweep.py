"""Grids of runs: what they expand to, what is run of them, and what survives."""

import functools
import importlib.util
import io
import os
import signal
import subprocess
import sys
import threading
import time

import pytest
import tyro
from places import REPO, TESTS
from rich.console import Console

from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.files.jsonl import read_jsonl
from jaxcam.runs import grid, sweep
from jaxcam.runs.grid import progress_of, read_grid
from jaxcam.runs.jobs import Here, Job, Submitit

FAKE = TESTS / "fake_jaxcam.py"
GRIDS = REPO / "grids"
SMALL = """
title: small
runs_dir: {folder}/runs
settings: {{preset: laptop, steps: 40, save_every: 10, log_every: 10, eval_every: 10, pairs: 4}}
runs:
  - {{task: lift, conditioning: [none, late], seed: [0, 1]}}
"""
needs_submitit = pytest.mark.skipif(
    importlib.util.find_spec("submitit") is None, reason="submitit is an extra"
)


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Writes a grid file whose runs are fakes."""
    monkeypatch.setattr(grid, "PYTHON", (sys.executable, str(FAKE)))
    monkeypatch.setattr(sweep, "SECONDS", 0.02)

    def write(text=SMALL):
        path = tmp_path / "grid.yaml"
        path.write_text(text.format(folder=tmp_path))
        return path

    return write


def run(plan, executor=None, jobs=2, retries=2):
    console = Console(file=io.StringIO())
    entries = sweep.sweep(plan, executor or Here(jobs), console, jobs=jobs, retries=retries)
    return {e.run.name: e for e in entries}, console.file.getvalue()


def starts(entry):
    return len(read_jsonl(entry.run.folder / "starts.jsonl"))


def test_a_grid_is_every_combination_once(write):
    text = SMALL + "  - {{task: lift, conditioning: late, seed: [0, 1], action_space: eef_delta}}\n"
    text += "  - {{task: lift, conditioning: late, seed: 0, crop_min: 1.0, n: 10, m: 0}}\n"
    plan = read_grid(write(text))
    usual = "lift-randomized-act-laptop-{}-steps40-{}"
    assert [r.name for r in plan.runs] == [
        usual.format("none", 0), usual.format("none", 1),
        usual.format("late", 0), usual.format("late", 1),  # stating a default is no other run
        "lift-randomized-act-laptop-late-steps40-crop_min1-n10-m0-0",
    ]  # fmt: skip
    (command,) = plan.runs[-1].commands()
    config = tyro.cli(TrainConfig, args=command[3:])
    assert (config.n, config.m, config.crop_min, config.steps) == (10, 0, 1.0, 40)
    assert config.run_dir == str(plan.runs[-1].folder)


def test_model_changes_are_lists_of_lists(write):
    text = SMALL + "  - {{task: lift, seed: 0, model: [[width=64], [width=64, heads=2], []]}}\n"
    models = [r.config.model for r in read_grid(write(text)).runs[4:]]
    assert models == [("width=64",), ("width=64", "heads=2"), ()]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("task: lift", "tsak: lift", "run 1: unknown setting 'tsak', did you mean 'task'"),
        ("task: lift", "task: lfit", "run 1: Unknown task 'lfit', did you mean 'lift'"),
        ("preset: laptop", "present: laptop", "settings: unknown setting 'present', did you mean"),
        ("runs_dir", "run_dirs", "unknown setting 'run_dirs', did you mean 'runs_dir'"),
        ("preset: laptop, ", "", "there is no 'preset'"),
        (", seed: [0, 1]", "", "there is no 'seed'"),
        ("[none, late]", "[]", "'conditioning' is an empty list"),
        ("title: small", "protocol: papr", "unknown protocol 'papr', did you mean 'paper'"),
        ("title: small", "protocol: paper", "takes the last 10 checkpoints, but .* keeps 4"),
        ("steps: 40", "steps: many", "steps must be int"),
        ("runs:", "runs: [", "cannot be read"),
    ],
)
def test_mistakes_in_a_grid_are_named(write, old, new, message):
    assert old in SMALL
    with pytest.raises(ConfigError, match=message):
        read_grid(write(SMALL.replace(old, new)))


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


@needs_submitit
@pytest.mark.filterwarnings("default")
def test_a_job_that_an_earlier_process_queued_is_found_again(tmp_path):
    class Queued:
        def __init__(self, folder, number):
            self.number = number

        def done(self):
            return self.number == "8"

    executor = Submitit("local", tmp_path, {})
    executor._kind = Queued
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


@pytest.mark.parametrize(
    "path", sorted(GRIDS.glob("*/*.yaml")), ids=lambda p: f"{p.parent.name}-{p.stem}"
)
def test_the_grids_of_the_repository_are_whole(path):
    plan = read_grid(path)
    assert plan.runs
    assert len({r.folder for r in plan.runs}) == len(plan.runs)
    seeds = {r.config.policy: set() for r in plan.runs}
    for r in plan.runs:
        seeds[r.config.policy].add(r.config.seed)
        assert len(r.steps) == 10
    assert all(s == ({0} if policy == "smolvla" else {0, 1, 2}) for policy, s in seeds.items())


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
