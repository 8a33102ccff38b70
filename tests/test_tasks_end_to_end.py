"""Every task from nothing to a report: demonstrations, pictures, training, evaluation.

Lift's whole path, interrupted on the way, is in test_cli.py.
"""

import json

import pytest

from jaxcam.config import TrainConfig, resolve
from jaxcam.presets import NAMES
from jaxcam.sim import make_task
from jaxcam.train import train

SETTINGS = {
    "pick_place_can": ("fixed", "joint_abs"),
    "square": ("randomized", "eef_abs"),
}
"""Scene and action space by task, so that of either several are run."""


@pytest.mark.parametrize("name", sorted({*NAMES["task"]} - {"lift"}))
def test_whole_path(name, tmp_path, monkeypatch):
    task = make_task(name)
    monkeypatch.setattr(type(task), "horizon", 160)  # enough for the expert, quick to fail
    scene, space = SETTINGS.get(name, ("randomized", "eef_delta"))
    config = TrainConfig(
        task=name, scene=scene, action_space=space, demos=2, validation=1, steps=4, batch=4,
        resolution=24, pairs=2, log_every=2, eval_every=4, save_every=4,
        data_dir=str(tmp_path / "data"), run_dir=str(tmp_path / "run"),
    )  # fmt: skip
    assert train(config) == 0
    found = json.loads((tmp_path / "run" / "config.json").read_text())
    assert (found["views"], found["n"], found["m"]) == (task.views, *task.stair)
    rows = [json.loads(r) for r in (tmp_path / "run/eval/rows.jsonl").read_text().splitlines()]
    assert [r["pair"] for r in rows] == [0, 1]
    for row in rows:
        assert (row["task"], row["scene"], row["status"]) == (name, scene, "ok")
        assert len(row["camera"]) == task.views
    assert (tmp_path / "run" / "report.html").stat().st_size > 10_000
    assert list((tmp_path / "run" / "videos").glob("*.mp4"))


def test_runs_of_other_spaces_and_cameras_have_their_own_folders():
    def folder(**changes):
        return resolve(TrainConfig(**changes), accelerator=False).run_dir.split("/")[1]

    assert folder(task="square") == "square-randomized-act-laptop-keypoints-0"
    assert folder(action_space="joint_abs").endswith("-keypoints-joint_abs-0")
    assert folder(n=5, m=2, views=2).endswith("-keypoints-n5m2-2views-0")
