"""Every task from nothing to a report: demonstrations, pictures, training, evaluation.

Lift's whole path, interrupted on the way, is in test_cli.py. CI runs one scene and action space of
most tasks, `pytest -m slow tests/test_tasks_end_to_end.py` all others.
"""

import itertools
import json
from typing import get_args

import pytest

from jaxcam.config.names import SceneName, TaskName
from jaxcam.config.train import TrainConfig
from jaxcam.pipeline.train import train
from jaxcam.runs.identity import resolve
from jaxcam.sim import make_task
from jaxcam.sim.actions import ACTION_SPACES
from jaxcam.sim.maniskill.task import ManiSkillTask

USUAL = {
    "pick_place_can": ("fixed", "joint_abs"),
    "square": ("randomized", "eef_abs"),
    "push": ("randomized", "eef_delta"),
    "roll_ball": ("fixed", "joint_delta"),
}
"""Scene and action space that CI runs, so that of either several are. Lift Upright's episodes are
long, and differ from the other two's in the task alone."""


def cases():
    for name, scene, space in itertools.product(
        get_args(TaskName), get_args(SceneName), ACTION_SPACES
    ):
        is_usual = USUAL.get(name) == (scene, space)
        yield pytest.param(name, scene, space, marks=() if is_usual else pytest.mark.slow)


@pytest.mark.parametrize(("name", "scene", "space"), list(cases()))
def test_whole_path(name, scene, space, tmp_path, monkeypatch, request):
    task = make_task(name)
    if isinstance(task, ManiSkillTask):
        request.getfixturevalue("maniskill")
    monkeypatch.setattr(type(task), "horizon", 160)  # enough for the expert, quick to fail
    config = TrainConfig(
        task=name, scene=scene, action_space=space, demos=2, validation=1, steps=4, batch=4,
        resolution=24, pairs=2, log_every=2, eval_every=4, save_every=4,
        model=("width=16", "layers=1", "encoder_width=8", "encoder_depth=1", "keypoints=4"),
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
