"""What the doctor says of a run's folder."""

import re
import shutil
from dataclasses import replace

import h5py
import pytest
from checked_run import CONFIG, flip, make_run, write
from running import exit_code
from spoilt import unseal

from jaxcam.checks.run import check_run
from jaxcam.config.fields import to_json

pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")


@pytest.fixture
def run(tmp_path, demos):
    return make_run(tmp_path / "runs" / "a", demos)


def findings(run):
    return {f.what: f for f in check_run(run)}


def test_a_whole_run(run):
    before = {p: p.read_bytes() for p in run.rglob("*") if p.is_file()}
    by_what = findings(run)
    notes = {f.what for f in by_what.values() if f.mark != "good"}
    assert notes == {"environment"}  # nothing wrote env.txt
    assert "resume at 2 of 6 updates" in by_what["what it can do"].got
    assert "loss 2 at step 1, 1 at 2" in by_what["metrics"].got
    assert {p: p.read_bytes() for p in run.rglob("*") if p.is_file()} == before


RUNS = {
    "no configuration": (
        lambda r: (r / "config.json").write_text("{"), "configuration", "bad", "not JSON"
    ),
    "an unknown setting": (
        lambda r: (r / "config.json").write_text('{"taks": 1}'), "configuration", "bad", "'taks'"
    ),
    "a flipped byte": (flip, "checkpoints", "bad", "changed since it was written|cannot be read"),
    "a lost manifest": (
        lambda r: shutil.rmtree(r / "checkpoints" / "1" / "manifest"), "checkpoints", "bad",
        "manifest",
    ),
    "no checkpoint": (
        lambda r: shutil.rmtree(r / "checkpoints"), "what it can do", "note", "from the start"
    ),
    "one set aside": (
        lambda r: (r / "damaged" / "3-0").mkdir(parents=True), "set aside", "note", "3-0"
    ),
    "no number in the metrics": (
        lambda r: write(r / "metrics.jsonl", [{"step": 1, "loss": float("nan")}]), "metrics",
        "bad", "1 are no numbers",
    ),
    "a run that diverged": (
        lambda r: write(r / "metrics.jsonl", [{"step": 1, "loss": 1.0, "skipped": 1.0}]),
        "metrics", "bad", "100.0% of updates were skipped",
    ),
    "a torn line within": (
        lambda r: (r / "metrics.jsonl").write_text('{"step"\n{}\n'), "metrics", "bad", "damaged"
    ),
    "the settings of another run": (
        lambda r: (r / "config.json").write_text(to_json(replace(CONFIG, lr=0.5))),
        "configuration", "bad", "lr: 0.001 -> 0.5",
    ),
    "other packages": (
        lambda r: (r / "env.txt").write_text("jax 0.0.1\n"), "environment", "note", "jax 0.0.1 →"
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", RUNS)
def test_what_is_wrong_with_a_run(run, case):
    change, what, mark, words = RUNS[case]
    change(run)
    first = next(f for f in check_run(run) if f.what == what and f.mark != "good")
    assert first.mark == mark, first
    assert re.search(words, first.got), first


def test_checkpoints_of_other_conventions(run, monkeypatch):
    monkeypatch.setattr("jaxcam.checks.run.CONVENTION", 99)
    (finding,) = (f for f in check_run(run) if f.what == "checkpoints" and f.mark == "bad")
    assert (finding.expected, finding.where) == ("99", "1, 2")


def test_a_dataset_that_is_gone_or_another(run, demos, tmp_path):
    config = replace(CONFIG, data_dir=tmp_path.name, run_dir="runs/a")
    (run / "config.json").write_text(to_json(config))
    assert findings(run)["dataset"].mark == "note"
    (tmp_path / tmp_path.name).mkdir()  # where the run was started, not where it is checked
    path = tmp_path / tmp_path.name / demos.path.name
    shutil.copy(demos.path, path)
    assert findings(run)["dataset"].where == str(path)
    assert findings(run)["dataset"].mark == "good"
    with h5py.File(path, "r+") as file:
        unseal(file)
        file["data/demo_0/actions"][0, 0] += 0.01
    finding = findings(run)["dataset"]
    assert (finding.mark, finding.expected) == ("bad", demos.fingerprint)


def test_a_run_from_the_command_line(run, capsys):
    assert exit_code("check", run) == 0
    assert "resume at 2 of 6" in capsys.readouterr().out
    assert "Findings" in (run / "check.html").read_text("utf-8")
    flip(run)
    assert exit_code("check", run) == 1
