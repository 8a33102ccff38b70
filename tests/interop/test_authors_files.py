"""The authors' CanRand and SquareRand: imported, replayed, and trained on."""

import h5py
import numpy as np
import pytest
from authors_files import NAMES, write_authors_file
from robomimic_files import imported

from jaxcam.config.train import TrainConfig
from jaxcam.errors import DatasetError
from jaxcam.interop.robomimic import success_of, task_of
from jaxcam.pipeline.train import train


@pytest.fixture(scope="module", params=NAMES)
def recording(request, tmp_path_factory):
    """A task, a file of the authors' layout, and the demonstrations that are in it."""
    task = request.param
    path = tmp_path_factory.mktemp(task) / f"{NAMES[task].lower()}_eef_delta.hdf5"
    return task, path, write_authors_file(path, task)


@pytest.mark.parametrize("actions", ["commands", "states"])
def test_states_objects_and_what_is_seen_are_carried_over(recording, actions):
    task, path, recorded = recording
    demos = imported(path, task=task, actions=actions, validation=1)
    assert (len(demos.train), len(demos.valid)) == (1, 1)
    assert task_of(path) == task
    for demo, one in zip(demos.episodes, recorded, strict=True):
        np.testing.assert_allclose(demo.states, one.states, atol=1e-9)
        poses, expected = demo.fixtures.copy(), one.fixtures.copy()
        for some in (poses, expected):  # a quaternion and its opposite are one rotation
            some[:, 3:] *= np.sign(some[:, 3:4] + 1e-12)
        np.testing.assert_allclose(poses, expected, atol=1e-9)
        if actions == "commands":
            np.testing.assert_allclose(demo.actions[:, :3], one.actions[:, :3], atol=1e-6)
            np.testing.assert_array_equal(demo.actions[:, 6], one.actions[:, 6])
    as_recorded, replayed = success_of(demos)
    assert as_recorded.all()
    assert replayed.all() or actions == "states"


def test_a_fixed_scene_keeps_its_table_and_its_room(recording):
    task, path, recorded = recording
    demos = imported(path, task=task, scene="fixed", actions="states", validation=0)
    for demo, one in zip(demos.train, recorded, strict=True):
        np.testing.assert_array_equal(demo.fixtures[:2, :2], 0)
        np.testing.assert_allclose(demo.fixtures[2:, :2], one.fixtures[2:, :2], atol=1e-9)


def test_what_is_imported_trains(recording, tmp_path):
    """At a toy's size, from the file to the report."""
    task, path, _ = recording
    demos = imported(path, task=task, validation=1)
    config = TrainConfig(
        task=task, preset="laptop", dataset=str(demos.path), data_dir=str(tmp_path), resolution=16,
        steps=1, batch=2, pairs=1, videos=0, run_dir=str(tmp_path / "run"),
        model=("width=8", "layers=1", "encoder_width=4", "keypoints=2"),
    )  # fmt: skip
    assert train(config) == 0
    rows = (tmp_path / "run" / "eval" / "rows.jsonl").read_text().splitlines()
    assert len(rows) == 1
    assert (tmp_path / "run" / "report.html").stat().st_size > 1000


def test_joints_are_read_off_the_states(tmp_path):
    path = tmp_path / "squarerand_joint_abs.hdf5"
    (one,) = write_authors_file(path, "square", seeds=(142,), actions="joint_abs")
    with pytest.raises(DatasetError, match=r"actions \(\d+, 8\)"):
        imported(path, task="square", validation=0)
    (demo,) = imported(path, task="square", actions="states", validation=0).train
    np.testing.assert_array_equal(demo.actions[:, 6], one.actions[:, 6])


def test_another_thing_than_the_authors_is_refused(tmp_path):
    path = tmp_path / "canrand_eef_delta.hdf5"
    write_authors_file(path, "pick_place_can", seeds=(142,))
    with pytest.raises(DatasetError, match="Import it with --task pick_place_can"):
        imported(path, task="lift")
    with h5py.File(path, "r+") as file:
        attributes = file["data/demo_0"].attrs
        attributes["model_file"] = attributes["model_file"].replace("plane_joint0", "plank_joint0")
    with pytest.raises(DatasetError, match="another task's or another robot's"):
        imported(path, task="pick_place_can", validation=0)
