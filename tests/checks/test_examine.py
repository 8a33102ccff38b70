"""The doctor as a person meets it: exit codes, words, the page, the pictures, run folders."""

import json
import re
import shutil
import subprocess
import sys
import time
from dataclasses import replace

import cv2
import h5py
import jax
import numpy as np
import pytest
from conftest import TINY
from running import exit_code

from jaxcam.checks import machine as env_module
from jaxcam.checks.examine import examine
from jaxcam.checks.findings import Finding, some, worst
from jaxcam.checks.overlays import (
    AXES,
    PATH,
    Moment,
    draw,
    draw_axes,
    draw_over,
    grip_pose,
    moments,
    sheet,
    table_pose,
)
from jaxcam.checks.page import write_png
from jaxcam.checks.run import check_run
from jaxcam.config.fields import to_json
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError, SimError
from jaxcam.rays import Camera
from jaxcam.runs.identity import resolve
from jaxcam.training.checkpoint import Checkpoints, make_side
from jaxcam.training.state import init_state, make_optimizer

pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")


def test_a_dataset_from_the_command_line(demos, tmp_path, monkeypatch, capsys):
    path = tmp_path / "lift.hdf5"
    shutil.copy(demos.path, path)
    assert exit_code("check", path, "--episodes", 2) == 0
    told = capsys.readouterr().out
    assert demos.fingerprint in told.replace("\n", "")
    assert "replay, eef_delta" in told
    page = (tmp_path / "lift.check.html").read_text("utf-8")
    assert not re.search(r'(src|href)="(?!data:)', page)
    assert page.count("<img") == 3
    assert "To mend" not in page
    assert "command, turn x (rad)" in page
    seen = cv2.imread(str(tmp_path / "lift.check.png"))
    assert seen.shape[1] > 2 * 320
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir() if p.suffix == ".hdf5"}
    assert before[path.name] == demos.path.read_bytes()


def test_a_bad_dataset_ends_with_1_and_says_how_to_mend_it(demos, tmp_path, monkeypatch, capsys):
    path, page = tmp_path / "lift.hdf5", tmp_path / "other.html"
    shutil.copy(demos.path, path)
    with h5py.File(path, "r+") as file:
        del file["data"].attrs["sha256"]
        poses = file["cameras/world_from_camera"]
        poses[...] = np.linalg.inv(poses[...])
    assert exit_code("check", path, "--episodes", 0, "--out", page) == 1
    told = capsys.readouterr().out
    assert "Likely cause: the matrices map world to camera" in told
    assert "<script" not in page.read_text("utf-8")
    assert "<h2>To mend</h2>" in page.read_text("utf-8")


def test_files_that_are_none(tmp_path, monkeypatch, capsys):
    web = tmp_path / "page.hdf5"
    web.write_text("<!DOCTYPE html>")
    assert exit_code("check", web) == 1
    assert "not an HDF5 file" in capsys.readouterr().out
    assert exit_code("check", tmp_path / "none.hdf5") == 1
    with pytest.raises(ConfigError, match=r"not a run folder.*no config\.json"):
        examine(tmp_path, 1)


def test_a_folder_that_cannot_be_written_to_loses_only_the_page(
    demos, tmp_path, monkeypatch, capsys
):
    (tmp_path / "file").write_text("")
    out = tmp_path / "file" / "page.html"
    assert exit_code("check", demos.path, "--episodes", 0, "--out", out) == 0
    assert "The page cannot be written" in capsys.readouterr().out


def test_a_simulator_that_is_missing_is_a_note(demos, monkeypatch):
    def require(self):
        raise SimError("pip install 'jaxcam[maniskill]'")

    from jaxcam.sim.tasks.lift import Lift

    monkeypatch.setattr(Lift, "require", require)
    report = examine(demos.path, 1)
    assert worst(report.findings) == "note"
    assert report.findings[-1].fix == "pip install 'jaxcam[maniskill]'"
    assert report.overlays is None


@pytest.mark.parametrize(
    ("flags", "match"),
    [
        ([], "Nothing to check"),
        (["x", "--env"], "not both"),
        (["x", "--episodes", "-1"], "least 0"),
    ],
)
def test_bad_flags(monkeypatch, capsys, flags, match):
    assert exit_code("check", *flags) == 2
    assert re.search(match, "".join(capsys.readouterr()))


def test_help_is_fast():
    took = []
    for _ in range(3):  # the best of three: the machine may be busy
        began = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-m", "jaxcam.check", "--help"], capture_output=True, text=True,
            check=True,
        )  # fmt: skip
        took.append(time.perf_counter() - began)
        assert "--episodes" in done.stdout
        if took[-1] < 3:
            return
    pytest.fail(f"--help took {took} s")


def test_axes_are_drawn_where_the_camera_projects_them():
    picture = np.zeros((100, 100, 3), np.uint8)
    camera = Camera.from_fovy(np.pi / 2, 100, 100, np.eye(4))
    pose = np.eye(4)
    pose[:3, 3] = 0, 0, 1
    draw_axes(picture, camera, pose, 0.5)  # x right, y down, z away from the camera
    np.testing.assert_array_equal(picture[50, 70], AXES[0])
    np.testing.assert_array_equal(picture[70, 50], AXES[1])
    assert not picture[:45].any()
    assert not picture[:, :45].any()
    behind = np.zeros_like(picture)
    pose[2, 3] = -1
    draw_axes(behind, camera, pose, 0.5)
    assert not behind.any()


def test_overlays_show_grip_and_table(demos, scene, renderer):
    demo = demos.train[1]
    np.testing.assert_allclose(grip_pose(demo, 3)[:3, 3], demo.eef_pos[3])
    table = table_pose(demo, scene)
    assert table[2, 3] == pytest.approx(0.8)
    np.testing.assert_allclose(table[:2, 3], demo.fixtures[0, :2])
    fresh = draw(demos, [Moment(1, 3, 2), Moment(1, 3, 1)], renderer)
    assert (fresh[0] != fresh[1]).any()
    drawn = np.zeros((64, 64, 3), np.uint8)
    draw_over(drawn, demos, Moment(1, 3, 2), scene)
    for colour in (*AXES, PATH):  # all of them are in the picture
        assert (abs(drawn - np.array(colour)).max(-1) < 40).any()
    whole = sheet([drawn] * 5, ["caption"] * 5)
    assert whole.shape[0] > 2 * 64
    np.testing.assert_array_equal(whole[4:68, 4:68], drawn)


def test_moments_are_spread_over_demonstrations_times_and_cameras(demos):
    shown = moments(demos, 4)
    assert [m.row for m in shown] == [0, 1, 3, 5]
    assert [m.camera for m in shown] == [0, 1, 2, 0]
    every = demos.episodes
    assert all(0 <= m.t < every[m.row].length for m in shown)
    assert len({m.t for m in shown}) == 4
    assert len(moments(demos, 99)) == 6


def test_png_keeps_the_colours(tmp_path):
    picture = np.zeros((4, 4, 3), np.uint8)
    picture[..., 0] = 200
    seen = cv2.imread(str(write_png(tmp_path / "a.png", picture)))
    assert seen[0, 0].tolist() == [0, 0, 200]


def test_the_first_names_and_how_many_more():
    assert some([1, 2]) == "1, 2"
    assert some(range(7), 3) == "0, 1, 2 and 4 more"


# --- run folders


CONFIG = resolve(TrainConfig(**TINY, steps=6, save_every=1, pairs=3), accelerator=False)


def save_checkpoints(folder, fingerprint, steps=(1, 2)):
    def init(key):
        return {"w": jax.random.normal(key, (64, 5))}

    side = make_side(
        CONFIG, settings=CONFIG, spec=CONFIG, stats={}, data=f"{fingerprint}-84px-eef_delta"
    )
    state = init_state(init, make_optimizer(CONFIG), jax.random.key(0))
    with Checkpoints(folder / "checkpoints") as checkpoints:
        for step in steps:
            checkpoints.save(replace(state, step=jax.numpy.int32(step)), side)


def row(step, pair, **values):
    return {
        "step": step, "split": "test", "pair": pair, "success": True, "status": "ok", "width": 50,
        "engine": "native", "ensemble": 0.0, **values,
    }  # fmt: skip


@pytest.fixture
def run(tmp_path, demos, monkeypatch):
    """A run folder after 2 of 6 updates, evaluated once, started where its dataset is."""
    (folder := tmp_path / "runs" / "a").mkdir(parents=True)
    config = replace(CONFIG, data_dir=str(demos.path.parent))
    (folder / "config.json").write_text(to_json(config))
    save_checkpoints(folder, demos.fingerprint)
    write(folder / "metrics.jsonl", [{"step": s, "loss": 3.0 - s, "skipped": 0.0} for s in (1, 2)])
    (folder / "eval").mkdir()
    write(folder / "eval" / "rows.jsonl", [row(2, pair) for pair in range(3)])
    return folder


def write(file, rows):
    file.write_text("".join(json.dumps(r) + "\n" for r in rows))


def findings(run):
    return {f.what: f for f in check_run(run)}


def test_a_whole_run(run):
    before = {p: p.read_bytes() for p in run.rglob("*") if p.is_file()}
    found = findings(run)
    notes = {f.what for f in found.values() if f.mark != "good"}
    assert notes == {"environment"}  # nothing wrote env.txt
    assert "resume at 2 of 6 updates" in found["what it can do"].got
    assert "loss 2 at step 1, 1 at 2" in found["metrics"].got
    assert {p: p.read_bytes() for p in run.rglob("*") if p.is_file()} == before


def flip(run):
    files = [p for p in (run / "checkpoints" / "2" / "params").rglob("*") if p.parent.name == "d"]
    file = max(files, key=lambda p: p.stat().st_size)
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 0x10
    file.write_bytes(content)


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
    "a rollout that failed": (
        lambda r: write(r / "eval" / "rows.jsonl",
                        [row(2, 0), row(2, 1), row(2, 2, status="error", success=False)]),
        "evaluation", "note", "2 of 3 pairs have an outcome; 1 ended in an error",
    ),
    "a rollout twice": (
        lambda r: write(r / "eval" / "rows.jsonl", [row(2, p) for p in (0, 1, 2, 1)]),
        "evaluation", "bad", "1 rollouts have several outcomes",
    ),
    "no evaluation": (lambda r: shutil.rmtree(r / "eval"), "evaluation", "note", "none yet"),
    "other packages": (
        lambda r: (r / "env.txt").write_text("jax 0.0.1\n"), "environment", "note", "jax 0.0.1 →"
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", RUNS)
def test_what_is_wrong_with_a_run(run, case):
    change, what, mark, words = RUNS[case]
    change(run)
    all_of_it = [f for f in check_run(run) if f.what == what and f.mark != "good"]
    assert all_of_it[0].mark == mark, all_of_it
    assert re.search(words, all_of_it[0].got), all_of_it[0]


def test_checkpoints_of_other_conventions(run, monkeypatch):
    monkeypatch.setattr("jaxcam.checks.run.CONVENTION", 99)
    (found,) = (f for f in check_run(run) if f.what == "checkpoints" and f.mark == "bad")
    assert (found.expected, found.where) == ("99", "1, 2")


def test_an_evaluation_that_was_stopped_says_how_to_go_on(run):
    rows = [row(1, p) for p in range(3)] + [row(2, 0)]
    write(run / "eval" / "rows.jsonl", rows)
    (found,) = (f for f in check_run(run) if f.what == "evaluation" and f.mark == "note")
    assert (found.got, found.where) == ("1 of 3 pairs have an outcome", "test, step 2")
    assert f"python -m jaxcam.evaluate {run} --split test --step 2 --pairs 3" in found.fix


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
        del file["data"].attrs["sha256"]
        file["data/demo_0/actions"][0, 0] += 0.01
    found = findings(run)["dataset"]
    assert (found.mark, found.expected) == ("bad", demos.fingerprint)


def test_a_run_from_the_command_line(run, monkeypatch, capsys):
    assert exit_code("check", run) == 0
    assert "resume at 2 of 6" in capsys.readouterr().out
    assert "Findings" in (run / "check.html").read_text("utf-8")
    flip(run)
    assert exit_code("check", run) == 1


# --- machines


def test_folders_that_caches_cannot_be_written_to(monkeypatch, tmp_path):
    assert env_module._host().mark == "good"
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("WARP_CACHE_PATH", str(tmp_path / "file" / "cache"))
    found = env_module._host()
    assert found.mark == "bad"
    assert "WARP_CACHE_PATH" in found.fix
    monkeypatch.setattr(env_module.tempfile, "gettempdir", lambda: str(tmp_path / "file"))
    assert "TMPDIR" in env_module._host().fix


def test_clock_and_file_names(monkeypatch):
    monkeypatch.setattr(env_module.time, "localtime", lambda: time.gmtime(0))
    monkeypatch.setattr(env_module.sys, "getfilesystemencoding", lambda: "ascii")
    found = env_module._host()
    assert "the clock says 1970" in found.got
    assert "PYTHONUTF8=1" in found.fix


def test_a_bad_machine_ends_with_1(monkeypatch, capsys):
    from jaxcam.checks import examine as check

    monkeypatch.setattr(check, "check_env", lambda: iter([Finding("host", "bad", "no clock")]))
    assert exit_code("check", "--env") == 1
    assert "no clock" in capsys.readouterr().out
