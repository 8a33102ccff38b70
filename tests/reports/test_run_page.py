"""The HTML page of a run, from synthetic rows."""

import base64
import json
import re
import shlex
from dataclasses import replace

import pytest
from run_rows import evaluation, training
from web_page import Page

from jaxcam.config.fields import to_json
from jaxcam.config.flags import parse
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.reports.run_figures import write_plots
from jaxcam.reports.run_page import reproduce_command, write_report
from jaxcam.results.rows import Row
from jaxcam.runs.identity import resolve


def write_lines(path, rows):
    path.parent.mkdir(exist_ok=True)
    lines = (row.to_json() if isinstance(row, Row) else row for row in rows)
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))


@pytest.fixture
def run(tmp_path):
    """A finished run, except for plots and videos."""
    config = resolve(TrainConfig(steps=6000, lr=5e-4, model=("width=256",)), accelerator=False)
    (tmp_path / "config.json").write_text(to_json(config))
    write_lines(tmp_path / "metrics.jsonl", training())
    write_lines(tmp_path / "eval" / "rows.jsonl", evaluation([1] * 20 + [0] * 30))
    return tmp_path


def test_page_is_whole_and_loads_nothing_from_outside(run):
    rows = evaluation([1] * 20 + [0] * 30)
    written = write_plots(run / "plots", training(), rows)
    assert [p.name for p in written] == ["loss.png", "success.png", "success_map.png"]
    (run / "videos").mkdir()
    (run / "videos" / "rollouts #1.mp4").write_bytes(b"video")
    path = write_report(run)
    page = Page(path)
    assert path == run / "report.html"
    sources = page.attributes("img", "src")
    assert len(sources) == 3
    expected = (run / "plots" / "success_map.png").read_bytes()
    assert base64.b64decode(sources[0].removeprefix("data:image/png;base64,")) == expected
    assert page.attributes("video", "src") == ["videos/rollouts%20%231.mp4"]
    assert not re.search(r"(https?:)?//[a-z]", re.sub(r"base64,[^\"]+", "", path.read_text()))
    assert page.attributes("link", "href") == ["data:,"]
    assert "script" not in {tag for tag, _ in page.tags}


def test_summary_says_what_was_measured(run):
    text = " ".join(Page(write_report(run)).text.split())
    assert "ACT on lift, randomized scene" in text
    assert "40.0 %" in text
    assert re.search(r"95 % interval 2\d\.\d to 5\d\.\d %, n = 50 pairs", text)
    for fact in ("6,000 of 6,000", "10 min 00 s", "step 6,000", "80 on average", "keypoints"):
        assert fact in text
    assert "did not finish" not in text
    assert "Success of each checkpoint" not in text


def test_unfinished_rollouts_are_announced_until_they_are_run_again(run):
    rows = evaluation([1] * 20 + [0] * 30)
    failed = [replace(row, status="error", success=None) for row in rows[:3]]
    write_lines(run / "eval" / "rows.jsonl", [*failed, *rows[3:]])
    text = Page(write_report(run)).text
    assert "3 rollouts did not finish" in text
    assert "n = 47 pairs" in text
    write_lines(run / "eval" / "rows.jsonl", [*failed, *rows])
    assert "did not finish" not in Page(write_report(run)).text


def test_only_held_out_pairs_of_the_newest_checkpoint_are_the_result(run):
    rows = evaluation([1] * 50, step=3000) + evaluation([1] * 10 + [0] * 40)
    write_lines(run / "eval" / "rows.jsonl", [*rows, *evaluation([1] * 50, split="validation")])
    text = Page(write_report(run)).text
    assert "20.0 %" in text
    assert "100.0 %" in text[text.index("Success of each checkpoint") :]


def test_what_was_seen_in_training_is_no_part_of_the_result(run):
    rows = [*evaluation([1] * 10 + [0] * 40), *evaluation([1] * 45 + [0] * 5, split="train")]
    write_lines(run / "eval" / "rows.jsonl", rows)
    text = " ".join(Page(write_report(run)).text.split())
    assert text.count("90.0 %") == 1
    assert "On cameras that training saw 90.0 %" in text
    assert "at step 6,000: memory, no result" in text
    assert text.index("20.0 %") < text.index("90.0 %")


def test_run_that_has_not_been_evaluated(tmp_path):
    (tmp_path / "config.json").write_text(
        to_json(resolve(TrainConfig(steps=6000), accelerator=False))
    )
    text = Page(write_report(tmp_path)).text
    assert "Not evaluated yet" in text
    assert "0 of 6,000" in text


def test_wall_time_adds_up_over_resumes(run):
    seconds = [(10, 100), (20, 200), (30, 40), (40, 3500)]
    write_lines(run / "metrics.jsonl", [{"step": s, "seconds": t} for s, t in seconds])
    assert "1 h 01 min" in Page(write_report(run)).text  # 200 s + 3500 s


def test_text_from_outside_is_escaped(run):
    (run / "env.txt").write_text("<script>alert(1)</script>")
    page = Page(write_report(run))
    assert "script" not in {tag for tag, _ in page.tags}
    assert "<script>alert(1)</script>" in page.text


def test_folder_that_is_no_run_and_damaged_rows(run, tmp_path_factory):
    empty = tmp_path_factory.mktemp("empty")
    with pytest.raises(ConfigError, match="not the folder of a run"):
        write_report(empty)
    (run / "eval" / "rows.jsonl").write_text("{torn\n{}\n")
    with pytest.raises(DatasetError, match="line 1"):
        write_report(run)
    assert not (run / "report.html").exists()


@pytest.mark.parametrize("accelerator", [False, True])
def test_reproduce_command_gives_the_same_settings(accelerator):
    config = resolve(
        TrainConfig(lr=5e-4, views=2, model=("width=256", "layers=2"), data_dir="my data"),
        accelerator=accelerator,
    )
    words = reproduce_command(config)
    assert "--batch" not in words  # the preset's own values go without saying
    again = resolve(parse(TrainConfig, shlex.split(words)[3:]), accelerator=accelerator)
    assert again == config


@pytest.mark.parametrize("accelerator", [False, True])
def test_reproduce_command_leaves_out_what_the_machine_decides(accelerator):
    config = resolve(TrainConfig(preset="paper"), accelerator=accelerator)
    assert (config.steps_per_call > 1) == accelerator
    assert "--steps-per-call" not in reproduce_command(config)


def test_links_out_of_the_run_are_not_embedded(run, tmp_path_factory):
    secret = tmp_path_factory.mktemp("elsewhere") / "secret.png"
    secret.write_bytes(b"a file of the system")
    (run / "plots").mkdir()
    (run / "plots" / "loss.png").symlink_to(secret)
    (run / "pictures").symlink_to(secret.parent)
    (run / "env.txt").symlink_to(secret)
    page = write_report(run).read_text("utf-8")
    assert base64.b64encode(secret.read_bytes()).decode() not in page
    assert "a file of the system" not in page
