"""Cameras of a file whose intrinsics differ: collected, kept, sealed, and in what is learned."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest

from jaxcam.config.datasets import CollectConfig
from jaxcam.data.batches import make_dataset
from jaxcam.data.cameras import camera_faults
from jaxcam.data.collection import (
    camera_windows,
    collect,
    dataset_path,
    in_task,
    new_header,
)
from jaxcam.data.demos import read_demos
from jaxcam.data.pictures import Pictures, views_of
from jaxcam.data.samples import Layout
from jaxcam.data.writer import DemoWriter
from jaxcam.errors import CameraError, DatasetError
from jaxcam.rays import Camera
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.sim import make_task

OPTICS = {"fovy": "35:55", "aspect": "1:1.5", "lens": "opencv:-0.3:0"}


@pytest.fixture(scope="module")
def alike(tmp_path_factory):
    """Demonstrations whose cameras are alike."""
    folder = str(tmp_path_factory.mktemp("alike"))
    return collect(CollectConfig(demos=1, validation=1, data_dir=folder))


@pytest.fixture(scope="module")
def varied(alike):
    """The same ones, filmed by cameras that differ."""
    config = in_task(
        CollectConfig(demos=1, validation=1, data_dir=str(alike.path.parent), **OPTICS)
    )
    header = new_header(config, alike.task, alike.world)
    path = dataset_path(config)
    with DemoWriter(path, header) as writer:
        for i, demo in enumerate(alike.episodes):
            writer.append(i, replace(demo, cameras=camera_windows(header)[i]))
    with DemoWriter(path, header) as writer:  # what is kept in between is the same
        writer.finish()
    return read_demos(path)


def test_a_file_of_its_own_has_k_and_lens_of_each_camera(alike, varied):
    assert varied.path != alike.path
    assert varied.header.optics == OPTICS
    assert np.array_equal(varied.header.world_from_camera, alike.header.world_from_camera)
    assert varied.header.K.shape == (4, 3, 3)
    assert varied.header.distortion.shape == (4, 9)
    assert varied.fingerprint != alike.fingerprint
    assert camera_faults(varied).tolerable
    with h5py.File(varied.path) as file:
        assert set(file["cameras"]) == {"world_from_camera", "K", "distortion"}
        assert "fovy_deg" not in file["cameras"].attrs  # there is none of all


def test_without_ranges_nothing_is_written_that_was_not_before(alike):
    assert alike.header.K is None
    assert "optics" not in alike.header.identity()
    with h5py.File(alike.path) as file:
        assert set(file["cameras"]) == {"world_from_camera"}
    assert np.array_equal(alike.header.intrinsics(84)[0], intrinsics(45.0, 84))


def test_pictures_and_samples_have_each_camera_s_own(varied):
    layout, size = Layout.of(varied), (24, 32)
    blank = np.zeros((layout.total, *size, 3), np.uint8)
    pictures = Pictures(blank, layout, np.ones(layout.total, bool))
    dataset = make_dataset(varied, pictures, "eef_delta", varied.world)
    batch = dataset.batch(np.array([0]), np.array([3]), np.array([[2, 0]]), 4)
    K = varied.header.intrinsics(*size)
    assert np.allclose(batch["K"][0], K[[2, 0]], rtol=1e-6)
    assert np.allclose(batch["distortion"][0], varied.header.distortion[[2, 0]], rtol=1e-6)
    view = views_of(varied.train[0], varied, "24x32", np.array([0, 1, 5]))
    assert np.array_equal(view.K, K[[0, 1, 2]])
    assert np.array_equal(view.lens, varied.header.distortion[[0, 1, 2]])


def test_samples_in_the_frame_of_the_grip_see_what_they_saw(varied):
    """A point has one place in the picture, in whichever frame it and the camera are."""
    layout = Layout.of(varied)
    pictures = Pictures(np.zeros((layout.total, 8, 8, 3), np.uint8), layout, np.ones(1))
    of = [np.array([0]), np.array([7]), np.array([[1]]), 2]
    named = {
        name: make_dataset(varied, pictures, "eef_delta", varied.world, name).batch(*of)
        for name in ("base", "grip")
    }
    demo, base = varied.train[0], varied.world.world_from_base
    grip = np.linalg.inv(demo.world_from_grip()[7]) @ base
    point = np.array([0.5, 0.1, 0.0, 1])  # base
    pixels = [
        Camera(named[name]["K"][0, 0], named[name]["base_from_camera"][0, 0], 8, 8).project(at[:3])[
            0
        ]
        for name, at in (("base", point), ("grip", grip @ point))
    ]
    assert np.allclose(*pixels, atol=1e-3)


def test_a_changed_lens_breaks_the_seal(varied, tmp_path):
    path = tmp_path / "changed.hdf5"
    path.write_bytes(varied.path.read_bytes())
    with h5py.File(path, "r+") as file:
        file["cameras/distortion"][1, 0] += 0.01
    with pytest.raises(DatasetError, match="not what was written"):
        read_demos(path)
    with h5py.File(path, "r+") as file:
        del file["cameras/distortion"]
        file["cameras"].create_dataset("distortion", data=np.zeros((4, 5)))
    with pytest.raises(DatasetError, match="cameras/distortion"):
        read_demos(path)


def test_the_task_s_field_of_view_is_not_varied():
    config = in_task(CollectConfig(demos=2, validation=1, fovy="45"))
    task = make_task("lift")
    header = new_header(config, task, task.scene("fixed"))
    assert np.allclose(header.intrinsics(96, 128), intrinsics(45.0, 96, 128), rtol=1e-14)
    assert header.K is None
    assert header.optics == {}


@pytest.mark.parametrize(("name", "said"), [("K", "fovy 35:55"), ("distortion", "opencv:-0.3:0")])
def test_ranges_without_their_arrays_are_refused(varied, tmp_path, name, said):
    """Or all cameras would be taken for the task's."""
    path = tmp_path / "lost.hdf5"
    path.write_bytes(varied.path.read_bytes())
    with h5py.File(path, "r+") as file:
        del file[f"cameras/{name}"]
        for seal in ("sha256", "sha256_of_all"):
            del file["data"].attrs[seal]
    with pytest.raises(DatasetError, match=f"cameras/{name} is missing.*{said}.*collect it again"):
        read_demos(path)


@pytest.mark.parametrize(
    ("optics", "words"),
    [({"fov": "35:55"}, "optics has 'fov'"), ({"fovy": "55:35"}, "fovy must be one value")],
)
def test_ranges_that_cannot_be_are_refused(varied, tmp_path, optics, words):
    path = tmp_path / "odd.hdf5"
    path.write_bytes(varied.path.read_bytes())
    with h5py.File(path, "r+") as file:
        data = file["data"].attrs
        data["jaxcam"] = json.dumps(json.loads(data["jaxcam"]) | {"optics": optics})
    with pytest.raises(DatasetError, match=words):
        read_demos(path)


def test_coefficients_that_are_no_numbers_are_refused_without_a_k(varied, tmp_path):
    path = tmp_path / "nan.hdf5"
    path.write_bytes(varied.path.read_bytes())
    with h5py.File(path, "r+") as file:
        file["cameras/distortion"][0, 0] = np.nan
        del file["cameras/K"]
        data = file["data"].attrs
        data["jaxcam"] = json.dumps(json.loads(data["jaxcam"]) | {"optics": {}})
    with pytest.raises(CameraError, match="cameras/distortion"):
        read_demos(path)


def test_texts_of_one_meaning_name_one_dataset():
    """Also where only the task knows that they mean nothing."""
    usual = dataset_path(CollectConfig())
    assert dataset_path(CollectConfig(fovy="45", lens="opencv:0:0", centre="-0")) == usual
    assert dataset_path(CollectConfig(fovy="44:45")) != usual


def test_lenses_of_two_meanings_are_two_files():
    """The second would be taken for the first, which is there already."""
    ways = ("opencv:-0.3:0,0.1", "opencv:-0.3,0:0.1")
    assert len({dataset_path(CollectConfig(lens=lens)) for lens in ways}) == 2


def test_older_headers_have_other_texts_of_one_meaning(varied):
    older = replace(varied.header, optics={"fovy": "45", "lens": "opencv:-0.3:0,0"})
    assert older.ranges == {"lens": "opencv:-0.3:0"}
