"""What is remembered of long jobs, and what is not."""

import io
import json

import pytest
from rich.console import Console

from jaxcam.config.train import TrainConfig
from jaxcam.console import paces as module
from jaxcam.console import progress as bars
from jaxcam.console.paces import (
    MOST,
    expected_seconds,
    in_words,
    keep_pace,
    paces,
    paces_file,
    training_job,
)
from jaxcam.console.progress import progress


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """A place of the test's own."""
    monkeypatch.setenv("JAXCAM_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_the_next_one_takes_as_long_a_step():
    assert expected_seconds("training", 10) is None
    keep_pace("training", 100, 50.0)
    assert expected_seconds("training", 10) == pytest.approx(5.0)
    keep_pace("training", 100, 200.0)
    assert paces() == {"training": 2.0}


@pytest.mark.parametrize(("job", "steps", "seconds"), [("", 9, 9), ("a", 1, 9), ("a", 9, 4.9)])
def test_what_tells_nothing_is_not_kept(job, steps, seconds):
    keep_pace(job, steps, seconds)
    assert not paces_file().exists()


@pytest.mark.parametrize("text", ["", "[1]", "{", '{"a": "b", "c": -1, "d": 2.0}', "\x00"])
def test_a_damaged_file_says_what_it_can(text):
    keep_pace("a", 9, 9.0)
    paces_file().write_text(text)
    assert set(paces()) <= {"d"}
    keep_pace("b", 9, 18.0)
    assert paces()["b"] == 2.0


def test_a_place_that_cannot_be_written_is_no_error(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("JAXCAM_CACHE", str(tmp_path / "file" / "x"))
    keep_pace("a", 9, 9.0)
    assert paces() == {}


def test_the_oldest_kinds_are_forgotten():
    for i in range(MOST + 2):
        keep_pace(str(i), 9, 9.0)
    known = json.loads(paces_file().read_text())
    assert len(known) == MOST
    assert "1" not in known


def test_words():
    assert in_words(None).startswith("no such work")
    assert [in_words(s).split(",")[0] for s in (0.1, 61, 600, 9000)] == [
        "about 1 s", "about 61 s", "about 10 min", "about 2.5 h",
    ]  # fmt: skip


def test_a_bar_tells_its_time_first_and_keeps_it(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(bars.time, "monotonic", lambda: clock[0])

    def run(advances):
        file = io.StringIO()
        with progress(Console(file=file), "drawing", 12, done=2, job="drawing") as advance:
            for _ in range(advances):
                clock[0] += 2.0
                advance()
        return file.getvalue().splitlines()[0]

    assert run(10) == "drawing (10 steps): no such work was timed on this machine yet"
    assert run(10) == "drawing (10 steps): about 20 s, as the last time on this machine"


def test_an_interrupted_bar_is_not_kept():
    with pytest.raises(KeyboardInterrupt), progress(Console(quiet=True), "a", 9, job="a"):
        raise KeyboardInterrupt
    assert paces() == {}


def test_kinds_of_trainings_differ_in_what_takes_time():
    base = TrainConfig(batch=8, resolution=84)
    others = [TrainConfig(batch=4, resolution=84), TrainConfig(batch=8, resolution=256)]
    jobs = {training_job(config, 1) for config in (base, *others)} | {training_job(base, 2)}
    assert len(jobs) == 4
    assert module.training_job(TrainConfig(batch=8, resolution=84, seed=7), 1) in jobs
