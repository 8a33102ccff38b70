"""Datasets of robots that differ in all that may differ: trained, resumed, judged and reported."""

import dataclasses

import numpy as np
import pytest
from six_robots import ROBOTS, write_robot

from jaxcam.config.train import TrainConfig
from jaxcam.pipeline.sources import source_of
from jaxcam.pipeline.train import train
from jaxcam.runs.action_errors import read_errors
from jaxcam.runs.identity import read_config, resolve
from jaxcam.runs.metrics import read_metrics

TINY = {
    "batch": 2, "warmup": 0, "resolution": 24, "preset": "laptop", "schedule": "constant",
    "model": ("width=16", "hidden=16", "chunk=3", "encoder_width=8", "keypoints=4"),
    "log_every": 1, "eval_every": 2, "save_every": 2,
}  # fmt: skip
"""A network of no use: all that the folder and the file of cameras say is left to them."""


def settings(name, folder, **changes):
    dataset, cameras = write_robot(name, folder)
    own = {"dataset": str(dataset), "cameras": str(cameras), "data_dir": str(folder / "data"),
           "run_dir": str(folder / "run")}  # fmt: skip
    return TrainConfig(**TINY, **own, **changes)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_is_read_with_its_cameras(tmp_path, name):
    robot = ROBOTS[name]
    config = settings(name, tmp_path, steps=2)
    source = source_of(config)
    config = resolve(source.complete(config), accelerator=False)
    data = source.dataset([config], None)
    batch = data.batch(
        np.array([0, 0]), np.array([0, 3]), np.tile(np.arange(config.views), (2, 1)), 3
    )
    assert batch["action"].shape == (2, 3, robot.actions)
    assert batch["proprio"].shape == (2, len(robot.states))
    assert batch["image"].shape[:2] == (2, len(robot.eyes))
    for v, (rows, columns, lens, moves) in enumerate(robot.eyes.values()):
        pose, other = batch["base_from_camera"][:, v]
        assert moves == (not np.array_equal(pose, other))
        # K was for twice the size, and pictures are scaled evenly into their place
        height, width = batch["image"].shape[2:4]
        zoom = min(height / rows, width / columns)
        assert batch["K"][0, v, 0, 0] == pytest.approx((1.8 * columns + 3 * v) / 2 * zoom, rel=0.05)
        assert (lens == "pinhole") == (
            data.distortion is None or not batch["distortion"][0, v].any()
        )


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_trains_resumes_and_is_judged(tmp_path, name):
    robot = ROBOTS[name]
    config = settings(name, tmp_path, steps=2)
    for steps in (2, 4):
        assert train(dataclasses.replace(config, steps=steps)) == 0
    run = tmp_path / "run"
    config = read_config(run)
    assert config.views == len(robot.eyes)
    assert [row["step"] for row in read_metrics(run) if "loss" in row] == [1, 2, 3, 4]
    rows = read_errors(run)
    assert {(row.step, row.group) for row in rows} == {(2, "new episodes"), (4, "new episodes")}
    assert all(row.errors.shape == (1, 3, robot.actions) for row in rows)
    assert all(np.isfinite(row.errors[:, 0]).all() for row in rows)
    assert f"recorded dataset {name}" in (run / "report.html").read_text()
    # both runs looked at one cache, and what was given is as it was
    assert len(list((tmp_path / "data" / "frames").glob("*.npy"))) == 1
