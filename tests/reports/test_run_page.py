"""Figures and the HTML page of a run, from synthetic rows."""

import base64
import json
import re
import shlex
import subprocess
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
from web_page import Page

from jaxcam.config.fields import to_json
from jaxcam.config.flags import parse
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.reports import run_figures as plots
from jaxcam.reports.run_page import reproduce_command, write_report
from jaxcam.results.rows import Row
from jaxcam.runs.identity import resolve


def evaluation(outcomes, **fields):
    """One row a pair, the cameras spread over the sphere patch."""
    angles = np.random.default_rng(0).uniform((-90, 30), (90, 60), (len(outcomes), 2))
    common = {"task": "lift", "seed": 0, "step": 6000, "steps": 80, "distance": 1.0}
    return [
        Row(pair=i, status="ok", success=bool(won), azimuth_deg=az, elevation_deg=el,
            **{**common, **fields})
        for i, (won, (az, el)) in enumerate(zip(outcomes, angles.tolist(), strict=True))
    ]  # fmt: skip


def training(steps=6000):
    rows = [{"step": s, "loss": 30 / s, "seconds": s / 10} for s in range(50, steps + 1, 50)]
    rows += [{"step": s, "val_loss": 40 / s} for s in range(500, steps + 1, 500)]
    return [*rows, {"step": steps, "success_rate": 0.4, "low": 0.3, "high": 0.5, "pairs": 50}]


def texts(axes):
    return [text.get_text() for text in axes.texts]


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
    written = plots.write_plots(run / "plots", training(), rows)
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


def test_success_map_counts_cameras_in_bins():
    rows = evaluation([1, 0] * 25)
    figure = plots.success_map([*rows, *evaluation([1] * 50, seed=1)])
    _main, top, side = figure.axes[:3]
    azimuth = np.array([row.azimuth_deg for row in rows])
    counts, _ = np.histogram(azimuth, np.arange(-90, 91, 30))
    assert texts(top) == [f"n = {n}" for n in counts if n]  # two seeds, still one camera each
    assert sum(int(t.removeprefix("n = ")) for t in texts(side)) == 50


def test_success_map_leaves_out_unfinished_rollouts():
    rows = evaluation([1, 0] * 25)
    rows = [replace(row, status="error") for row in rows[:20]] + rows[20:]
    top = plots.success_map(rows).axes[1]
    assert sum(int(t.removeprefix("n = ")) for t in texts(top)) == 30


def test_smoothed_rate_follows_the_outcomes():
    rows = [replace(row, success=row.azimuth_deg > 0) for row in evaluation([0] * 50)]
    field = plots.success_map(rows).axes[0].images[0].get_array()
    assert field[:, 10].max() < 0.2
    assert field[:, -10].min() > 0.8


def test_curves_show_what_was_logged(tmp_path):
    (axes,) = plots.loss_curves(training()).axes
    assert axes.get_yscale() == "log"
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["training", "validation"]
    (axes,) = plots.success_curve(training()).axes
    assert "40 %" in texts(axes)
    for figure in (plots.loss_curves([]), plots.success_curve([]), plots.success_map([])):
        plots.save(figure, tmp_path / "empty.svg")
    assert (tmp_path / "empty.svg").read_text().startswith("<?xml")
    assert plots.write_plots(tmp_path, [], []) == []


def test_camera_poses_are_drawn_where_they_are():
    pose = np.eye(4)
    pose[:3, 3] = (0.6, 0.8, 1.3)
    above, side = plots.camera_places(pose[None], pose[None], centre=(0, 0, 0.8)).axes
    position = [line.get_xydata()[0] for line in above.lines if len(line.get_xydata()) == 1]
    assert position[0] == pytest.approx([0.6, 0.8])
    position = [line.get_xydata()[0] for line in side.lines if len(line.get_xydata()) == 1]
    assert position[0] == pytest.approx([1.0, 0.5])


def test_ray_picture_shows_directions_as_colours(tmp_path):
    rays = np.zeros((8, 8, 6), np.float32)
    rays[..., 2] = 1
    image = np.full((8, 8, 3), 128, np.uint8)
    figure = plots.ray_picture(image, rays)
    assert np.allclose(figure.axes[1].images[0].get_array(), (0.5, 0.5, 1))
    path = plots.save(figure, tmp_path / "new" / "rays.png")
    assert cv2.imread(str(path)).shape == (512, 1312, 3)
    with pytest.raises(ValueError, match=r"\[H, W, 6\]"):
        plots.ray_picture(image, rays[..., :3])


def test_figures_need_no_pyplot_and_change_no_settings():
    code = (
        "import sys, matplotlib as mpl; before = mpl.rcParams.copy()\n"
        "from jaxcam.reports import run_figures as plots\n"
        "plots.loss_curves([{'step': 1, 'loss': 1.0}])\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
        "assert mpl.rcParams.copy() == before\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


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
