"""Demonstration files: their layout, resuming a killed collection, and every kind of damage."""

import json
import logging

import h5py
import numpy as np
import pytest
from conftest import TINY
from spoilt import assert_refused, put, unseal

from jaxcam.config.datasets import CollectConfig
from jaxcam.data.collection import collect
from jaxcam.data.contents import ARRAYS, OPTIONAL
from jaxcam.data.demos import read_demos
from jaxcam.errors import DatasetError
from jaxcam.rays import ROTATION_TOLERANCE, stair_cameras


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
            arrays = []
            group.visititems(
                lambda key, item, arrays=arrays: (
                    arrays.append(key) if isinstance(item, h5py.Dataset) else None
                )
            )
            assert set(arrays) == set(ARRAYS) - OPTIONAL, name
            assert all(group[key].fletcher32 for key in arrays)
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


def test_a_complete_dataset_is_read_not_collected(demos, data_dir, monkeypatch):
    monkeypatch.setattr("jaxcam.data.collection.run_expert", None)
    before = demos.path.stat().st_mtime_ns
    assert collect(CollectConfig(**TINY, data_dir=str(data_dir))).fingerprint == demos.fingerprint
    assert demos.path.stat().st_mtime_ns == before


def test_missing_file(tmp_path):
    assert_refused(
        tmp_path / "none.hdf5", "no such dataset. Make it with: python -m jaxcam.collect"
    )


@pytest.mark.parametrize("share", [0.001, 0.3, 0.99])
def test_truncated_file(copy, share):
    whole = copy.read_bytes()
    copy.write_bytes(whole[: int(share * len(whole))])
    assert_refused(copy, "damaged or truncated")


def test_flipped_byte_in_an_array(copy):
    with h5py.File(copy) as file:
        offset = file["data/demo_2/states"].id.get_chunk_info(0).byte_offset
    content = bytearray(copy.read_bytes())
    content[offset + 100] ^= 4
    copy.write_bytes(content)
    assert_refused(copy, "demo_2: checksum or read error")


def test_flipped_byte_in_the_cameras(copy):
    with h5py.File(copy) as file:
        offset = file["cameras/world_from_camera"].id.get_chunk_info(0).byte_offset
    content = bytearray(copy.read_bytes())
    content[offset + 100] ^= 4
    copy.write_bytes(content)
    assert_refused(copy, "damaged|checksum")


def test_flipped_bytes_anywhere_are_noticed_or_harmless(copy, demos):
    whole = copy.read_bytes()
    rng = np.random.default_rng(0)
    for place in rng.integers(0, len(whole), 80):
        content = bytearray(whole)
        content[place] ^= 1 << int(rng.integers(8))
        copy.write_bytes(content)
        try:
            read = read_demos(copy, task="lift", scene="randomized")
        except DatasetError:
            continue
        assert read.fingerprint == demos.fingerprint, place


def test_not_hdf5(tmp_path):
    path = tmp_path / "page.hdf5"
    path.write_text("<!DOCTYPE html><html>Not found</html>")
    assert_refused(path, "not an HDF5 file; it starts with b'<!DOCTYP'")


def test_another_task_or_scene(demos):
    assert_refused(demos.path, "task 'lift', but 'square' was asked.*--task square", task="square")
    assert_refused(
        demos.path, "scene 'randomized', but 'fixed' was asked", task="lift", scene="fixed"
    )


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
    assert_refused(copy, match)


def shift(file, name, by):
    file[name][...] += by


def scale(file, name, by):
    file[name][...] *= by


IMPOSSIBLE = {
    "a size that is none": (
        lambda f: f["data/demo_1/start/geom_size"].__setitem__((0, 0), np.nan),
        "non-finite geom_size",
    ),
    "a negative size": (
        lambda f: scale(f, "data/demo_1/start/geom_size", -1), "geom_size that is not positive",
    ),
    "no size": (
        lambda f: scale(f, "data/demo_1/start/geom_size", 0), "geom_size that is not positive",
    ),
    "infinite fixtures": (
        lambda f: shift(f, "data/demo_1/start/fixtures", np.inf), "non-finite fixtures",
    ),
    "a table without an orientation": (
        lambda f: f["data/demo_1/start/fixtures"].__setitem__((0, slice(3, 7)), 0),
        "fixtures whose quaternions",
    ),
    "fixtures of another task": (
        lambda f: put(f, "data/demo_1/start/fixtures", np.tile([0, 0, 0, 1.0, 0, 0, 0], (3, 1))),
        "fixtures has 3 rows, but in lift it has 2",
    ),
    "sizes of another task": (
        lambda f: put(f, "data/demo_1/start/geom_size", np.zeros((0, 3))),
        "geom_size has 0 rows",
    ),
    "sizes of another shape": (
        lambda f: put(f, "data/demo_1/start/geom_size", np.ones(3)),
        r"geom_size is \[3\], expected \[any, 3\]",
    ),
    "far away": (
        lambda f: f["data/demo_1/states"].__setitem__((4, 11), 1e30), "states beyond 10000",
    ),
    "a command far away": (
        lambda f: f["data/demo_1/actions"].__setitem__((4, 1), -1e30), "actions beyond 10000",
    ),
    "whole numbers": (
        lambda f: put(f, "data/demo_1/states", f["data/demo_1/states"][:].astype(int)),
        "states is int64, expected floating-point",
    ),
    "text": (
        lambda f: put(f, "data/demo_1/obs/robot0_gripper",
                      f["data/demo_1/obs/robot0_gripper"][:].astype("S8")),
        "gripper is .*expected floating-point",
    ),
    "a cube without an orientation": (
        lambda f: f["data/demo_1/states"].__setitem__((4, slice(13, 17)), 0),
        "states whose quaternions have not length 1: 1 of .*at step 4",
    ),
    "a cube's quaternion of another length": (
        lambda f: f["data/demo_1/states"].__setitem__((slice(None), slice(13, 17)), 0.6),
        "states whose quaternions",
    ),
    "a grip without an orientation": (
        lambda f: scale(f, "data/demo_1/obs/robot0_eef_quat", 0), "eef_quat whose quaternions",
    ),
    "a gripper in millimetres": (
        lambda f: scale(f, "data/demo_1/obs/robot0_gripper", 40), "gripper beyond -1 to 1",
    ),
    "errors that are numbers": (
        lambda f: f["data/demo_1"].create_dataset("errors", data=np.zeros(3)), "errors is",
    ),
    "nothing but errors": (
        lambda f: f["data/demo_1"].create_dataset(
            "errors", data=np.ones(len(f["data/demo_1/actions"]), bool)
        ),
        "demo_1: all .* steps are errors, so nothing is left to imitate",
    ),
    "errors of whole numbers": (
        lambda f: f["data/demo_1"].create_dataset(
            "errors", data=np.ones(len(f["data/demo_1/actions"]), int)
        ),
        "errors is int64, expected true or false",
    ),
    "cameras between two": (
        lambda f: f["data/demo_1"].attrs.__setitem__("cameras", [0.5, 1, 2]),
        "cameras are float64",
    ),
    "half a seed": (
        lambda f: f["data/demo_1"].attrs.__setitem__("seed", 1.5), "seed is 1.5",
    ),
    "cameras of whole numbers": (
        lambda f: put(f, "cameras/world_from_camera", np.tile(np.eye(4, dtype=int), (8, 1, 1))),
        "world_from_camera is int64",
    ),
    "a group for an array": (
        lambda f: [f.__delitem__("data/demo_1/actions"), f.create_group("data/demo_1/actions")],
        "actions is a group",
    ),
    "cameras in a group": (
        lambda f: [f.__delitem__("cameras/world_from_camera"),
                   f.create_group("cameras/world_from_camera")],
        "world_from_camera is a group",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", IMPOSSIBLE)
def test_what_cannot_be_is_refused_without_a_seal_too(copy, case):
    spoil, words = IMPOSSIBLE[case]
    with h5py.File(copy, "r+") as file:
        unseal(file)
        spoil(file)
    assert_refused(copy, words)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("task", 3), ("task", "lyft"), ("scene", None), ("scene", "moon"), ("n", "3"), ("m", -1),
        ("train", 1e9), ("train", 10**12), ("valid", True), ("nq", 1.5), ("nv", [15]),
        ("seed", "0"), ("fovy_deg", "wide"), ("versions", ["1"]), ("versions", {"jaxcam": 1}),
        ("surprise", 1),
    ],
)  # fmt: skip
def test_a_header_of_other_kinds_is_refused(copy, name, value):
    with h5py.File(copy, "r+") as file:
        unseal(file)
        about = json.loads(file["data"].attrs["jaxcam"])
        file["data"].attrs["jaxcam"] = json.dumps({**about, name: value})
    assert_refused(copy, f"header.*{name}|{name} ")


def test_a_header_that_is_a_list(copy):
    with h5py.File(copy, "r+") as file:
        file["data"].attrs["jaxcam"] = "[1]"
    assert_refused(copy, "no jaxcam header")


def test_cut_demonstration(copy):
    with h5py.File(copy, "r+") as file:
        states = file["data/demo_0/states"][:-1]
        del file["data/demo_0/states"]
        file["data/demo_0"].create_dataset("states", data=states)
    assert_refused(copy, "actions need .* states")


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
        unseal(file)
        poses = file["cameras/world_from_camera"]
        poses[...] = np.round(poses[...], 4)
    with caplog.at_level(logging.WARNING):
        poses = read_demos(copy).header.world_from_camera
    assert len(caplog.records) == 1
    assert "rotations of 8 of 8 cameras are rounded" in caplog.text
    rotation = poses[:, :3, :3]
    error = abs(rotation.swapaxes(-1, -2) @ rotation - np.eye(3)).max()
    assert error < 1e-12 < ROTATION_TOLERANCE
