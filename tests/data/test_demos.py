"""Demonstration files: their layout, resuming a killed collection, and every kind of damage."""

import json
import logging
import shutil
import signal
import subprocess
import sys

import h5py
import numpy as np
import pytest
from conftest import TINY

from jaxcam.config.datasets import CollectConfig
from jaxcam.data.collection import collect, dataset_path
from jaxcam.data.demos import read_demos
from jaxcam.data.writer import DemoWriter
from jaxcam.errors import DatasetError
from jaxcam.rays import ROTATION_TOLERANCE, stair_cameras

LAYOUT = {
    "states",
    "actions",
    "obs/robot0_eef_pos",
    "obs/robot0_eef_quat",
    "obs/robot0_gripper",
    "start/geom_size",
    "start/fixtures",
}

KILLED = """
import os, signal, sys
import h5py
from jaxcam.config.datasets import CollectConfig
from jaxcam.data.collection import collect
from jaxcam.data.writer import DemoWriter
append, create, count = DemoWriter.append, h5py.Group.create_dataset, 0
def count_and_append(self, index, demo):
    global count
    count += 1
    append(self, index, demo)
def die_half_way(self, name, *args, **kwargs):
    if count == 4 and name.startswith("obs"):
        os.kill(os.getpid(), signal.SIGKILL)
    return create(self, name, *args, **kwargs)
DemoWriter.append, h5py.Group.create_dataset = count_and_append, die_half_way
collect(CollectConfig(demos=4, validation=2, data_dir=sys.argv[1]))
"""


@pytest.fixture
def copy(demos, tmp_path):
    path = tmp_path / demos.path.name
    shutil.copy(demos.path, path)
    return path


def refused(path, match, **expected):
    """Reading fails with that message and leaves the folder as it was."""
    before = {p: p.read_bytes() for p in path.parent.iterdir() if p.is_file()}
    with pytest.raises(DatasetError, match=match) as error:
        read_demos(path, **expected)
    assert {p: p.read_bytes() for p in path.parent.iterdir() if p.is_file()} == before
    assert str(path) in str(error.value)


def test_layout_is_robomimics(demos):
    header = demos.header
    with h5py.File(demos.path) as file:
        assert set(file) == {"data", "cameras", "mask"}
        data = file["data"]
        assert json.loads(data.attrs["env_args"])["env_name"] == "lift"
        assert data.attrs["total"] == sum(d.length for d in demos.episodes)
        train = [name.decode() for name in file["mask/train"]]
        valid = [name.decode() for name in file["mask/valid"]]
        assert train == [f"demo_{i}" for i in range(4)]
        assert sorted(train + valid) == sorted(data)
        for name, group in data.items():
            found = []
            group.visititems(
                lambda key, item, found=found: (
                    found.append(key) if isinstance(item, h5py.Dataset) else None
                )
            )
            assert set(found) == LAYOUT, name
            assert all(group[key].fletcher32 for key in found)
            steps = group.attrs["num_samples"]
            assert group["actions"].shape == (steps, 7)
            assert group["states"].shape == (steps + 1, 1 + header.nq + header.nv)
            np.testing.assert_allclose(group["states"][:, 0], np.arange(steps + 1) / 20)
            np.testing.assert_allclose(
                np.linalg.norm(group["obs/robot0_eef_quat"], axis=-1), 1, atol=1e-9
            )
    cameras = stair_cameras(4, 3, 1)
    assert [d.cameras.tolist() for d in demos.train] == [[i, i + 1, i + 2] for i in range(4)]
    assert [d.cameras.tolist() for d in demos.valid] == [[cameras], [cameras + 1]]
    assert len(header.world_from_camera) == cameras + 2
    assert not demos.path.with_name(demos.path.name + ".part").exists()


def test_a_killed_collection_ends_as_an_uninterrupted_one(demos, tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", KILLED, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    config = CollectConfig(**TINY, data_dir=str(tmp_path))
    part = dataset_path(config).with_name(dataset_path(config).name + ".part")
    assert not dataset_path(config).exists()
    with DemoWriter(dataset_path(config), demos.header) as writer:
        assert writer.done == {0, 1, 2}  # the fourth was being written
        with pytest.raises(DatasetError, match=r"\[3, 4, 5\]"):
            writer.finish()
    with h5py.File(part) as file:  # what is on disk is kept, not collected again
        kept = file["data/demo_1/states"].id.get_chunk_info(0).byte_offset
    resumed = collect(config)
    assert resumed.fingerprint == demos.fingerprint
    with h5py.File(resumed.path) as file:
        assert file["data/demo_1/states"].id.get_chunk_info(0).byte_offset == kept
        assert file["data"].attrs["total"] == sum(d.length for d in demos.episodes)
    for a, b in zip(resumed.episodes, demos.episodes, strict=True):
        np.testing.assert_array_equal(a.eef_pos, b.eef_pos)
        np.testing.assert_array_equal(a.eef_quat, b.eef_quat)
        assert a.seed == b.seed


def test_a_complete_dataset_is_read_not_collected(demos, data_dir, monkeypatch):
    monkeypatch.setattr("jaxcam.data.collection.run_expert", None)
    before = demos.path.stat().st_mtime_ns
    assert collect(CollectConfig(**TINY, data_dir=str(data_dir))).fingerprint == demos.fingerprint
    assert demos.path.stat().st_mtime_ns == before


def test_missing_file(tmp_path):
    refused(tmp_path / "none.hdf5", "no such dataset. Make it with: python -m jaxcam.collect")


@pytest.mark.parametrize("share", [0.001, 0.3, 0.99])
def test_truncated_file(copy, share):
    whole = copy.read_bytes()
    copy.write_bytes(whole[: int(share * len(whole))])
    refused(copy, "damaged or truncated")


def test_flipped_byte_in_an_array(copy):
    with h5py.File(copy) as file:
        offset = file["data/demo_2/states"].id.get_chunk_info(0).byte_offset
    content = bytearray(copy.read_bytes())
    content[offset + 100] ^= 4
    copy.write_bytes(content)
    refused(copy, "demo_2: checksum or read error")


def test_flipped_byte_in_the_cameras(copy):
    with h5py.File(copy) as file:
        offset = file["cameras/world_from_camera"].id.get_chunk_info(0).byte_offset
    content = bytearray(copy.read_bytes())
    content[offset + 100] ^= 4
    copy.write_bytes(content)
    refused(copy, "damaged|checksum")


def test_flipped_bytes_anywhere_are_noticed_or_harmless(copy, demos):
    whole = copy.read_bytes()
    rng = np.random.default_rng(0)
    for place in rng.integers(0, len(whole), 80):
        content = bytearray(whole)
        content[place] ^= 1 << int(rng.integers(8))
        copy.write_bytes(content)
        try:
            found = read_demos(copy, task="lift", scene="randomized")
        except DatasetError:
            continue
        assert found.fingerprint == demos.fingerprint, place


def test_not_hdf5(tmp_path):
    path = tmp_path / "page.hdf5"
    path.write_text("<!DOCTYPE html><html>Not found</html>")
    refused(path, "not an HDF5 file; it starts with b'<!DOCTYP'")


def test_another_task_or_scene(demos):
    refused(demos.path, "task 'lift', but 'square' was asked.*--task square", task="square")
    refused(demos.path, "scene 'randomized', but 'fixed' was asked", task="lift", scene="fixed")


@pytest.mark.parametrize(
    ("spoil", "match"),
    [
        (lambda f: f.__delitem__("cameras/world_from_camera"), "no cameras"),
        (lambda f: f["data/demo_1"].attrs.__setitem__("cameras", [1, 99, 2]), "99.*are missing"),
        (lambda f: f["data/demo_1"].attrs.__setitem__("cameras", []), "cameras.*are missing"),
        (lambda f: f.__delitem__("data/demo_3"), "data/demo_3 is missing"),
        (lambda f: f.__delitem__("data/demo_3/actions"), "demo_3: .*actions"),
        (lambda f: f["data/demo_0/actions"].__setitem__((3, 2), np.nan), "demo_0: non-finite"),
        (lambda f: f["data"].attrs.__delitem__("jaxcam"), "no jaxcam header; found"),
        (lambda f: f["data"].attrs.__setitem__("jaxcam", "{"), "header"),
        (lambda f: f["data"].attrs.__setitem__("jaxcam", '{"format": 99}'), "format 99, but"),
        (lambda f: f["data"].attrs.__setitem__("jaxcam", '{"format": 1}'), "header"),
        (lambda f: f.__delitem__("data"), "no jaxcam header; found"),
    ],
)
def test_what_is_in_the_file_is_checked(copy, spoil, match):
    with h5py.File(copy, "r+") as file:
        spoil(file)
    refused(copy, match)


def test_another_seed_of_an_episode_breaks_the_seal(copy):
    """An attribute has no checksum; whether an episode is the evaluation's is told by its seed."""
    with h5py.File(copy, "r+") as file:
        file["data/demo_2"].attrs["seed"] += 1
    refused(copy, "damaged: its content is not what was written")


def test_cut_demonstration(copy):
    with h5py.File(copy, "r+") as file:
        states = file["data/demo_0/states"][:-1]
        del file["data/demo_0/states"]
        file["data/demo_0"].create_dataset("states", data=states)
    refused(copy, "actions need .* states")


def test_unfinished_file_of_other_settings(copy, demos):
    part = copy.with_name(copy.name + ".part")
    copy.rename(part)
    before = part.read_bytes()
    other = type(demos.header)(**{**demos.header.__dict__, "scene": "fixed", "n": 2})
    with pytest.raises(DatasetError, match="scene: file randomized, asked fixed, n: file 3, ask"):
        DemoWriter(copy, other)
    assert part.read_bytes() == before


def test_unfinished_file_that_is_damaged(copy, demos):
    part = copy.with_name(copy.name + ".part")
    part.write_bytes(copy.read_bytes()[:5000])
    with pytest.raises(DatasetError, match=r"unfinished file that cannot be opened.*Delete"):
        DemoWriter(copy, demos.header)
    assert part.stat().st_size == 5000


def test_two_collectors_do_not_write_one_file(tmp_path, demos):
    path = tmp_path / "both.hdf5"
    with DemoWriter(path, demos.header) as first:
        code = (
            "import sys, h5py\n"
            "try: h5py.File(sys.argv[1], 'r+')\n"
            "except BlockingIOError: print('locked')"
        )
        done = subprocess.run(
            [sys.executable, "-c", code, str(first.part)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.stdout.strip() == "locked", done.stderr


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    config = CollectConfig(**TINY, data_dir=str(tmp_path / "file" / "data"))
    with pytest.raises(DatasetError, match=r"Cannot write to .*--data-dir"):
        collect(config)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda f: f.create_group("traj_0"), "python -m jaxcam.maniskill"),
        (lambda f: f.create_group("data").attrs.__setitem__("env_args", "{}"), "jaxcam.robomimic"),
        (lambda f: f.create_group("data").attrs.__setitem__("env", "Lift"), "convert_robosuite"),
        (lambda f: f.create_group("observations"), r"found \['observations'\].*docs/data.md"),
    ],
)
def test_files_in_other_layouts_are_told_what_to_do_with(tmp_path, make, words):
    path = tmp_path / "other.hdf5"
    with h5py.File(path, "w") as file:
        make(file)
    with pytest.raises(DatasetError, match=words):
        read_demos(path)


def test_rounded_rotations_are_made_rotations_again_and_told_once(copy, caplog):
    with h5py.File(copy, "r+") as file:
        del file["data"].attrs["sha256"]
        poses = file["cameras/world_from_camera"]
        poses[...] = np.round(poses[...], 4)
    with caplog.at_level(logging.WARNING):
        poses = read_demos(copy).header.world_from_camera
    assert len(caplog.records) == 1
    assert "rotations of 8 of 8 cameras are rounded" in caplog.text
    rotation = poses[:, :3, :3]
    error = abs(rotation.swapaxes(-1, -2) @ rotation - np.eye(3)).max()
    assert error < 1e-12 < ROTATION_TOLERANCE
