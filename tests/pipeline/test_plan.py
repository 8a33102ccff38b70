"""The first lines of a training."""

import io

from rich.console import Console

from jaxcam.config.train import TrainConfig
from jaxcam.console.paces import collecting_job, keep_pace, rollouts_job, training_job
from jaxcam.pipeline.plan import show_plan
from jaxcam.runs.identity import resolve


def shown(config):
    """What is printed before a training."""
    file = io.StringIO()
    show_plan([resolve(config, accelerator=False)], Console(file=file))
    return file.getvalue().splitlines()


def test_what_is_timed_is_told_and_what_is_not_is_said_to_be_not(tmp_path, monkeypatch):
    monkeypatch.setenv("JAXCAM_CACHE", str(tmp_path / "cache"))
    config = TrainConfig(
        preset="laptop", demos=18, validation=2, steps=400, pairs=60, data_dir=str(tmp_path)
    )
    lines = shown(config)
    assert lines[0] == "lift: act, preset laptop, keypoints, seed 0"
    assert [line[:5] for line in lines[1:-1]] == ["  1. ", "  2. ", "  3. ", "  4. "]
    assert sum("no such work was timed" in line for line in lines) == 3
    keep_pace(collecting_job("lift", "randomized"), 10, 20.0)
    keep_pace(training_job(resolve(config, accelerator=False), 1), 100, 150.0)
    keep_pace(rollouts_job("lift", "native", 50), 150, 30.0)
    lines = shown(config)
    assert "20 demonstrations are collected: about 40 s" in lines[1]
    assert "400 updates of 64: about 10 min" in lines[3]
    assert "60 rollouts seen by cameras that it never saw: about 60 s" in lines[4]
    assert "report.html" in lines[5]


def test_what_is_there_is_not_collected(demos):
    config = TrainConfig(
        preset="laptop", demos=4, validation=2, steps=400, data_dir=str(demos.path.parent)
    )
    assert shown(config)[1] == f"  1. demonstrations, which are there: {demos.path}"
