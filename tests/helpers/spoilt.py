"""Datasets that are spoilt in one way, and what the doctor finds in them."""

import shutil

import h5py
import pytest

from jaxcam.checks.dataset import check_physics
from jaxcam.checks.examine import check_dataset
from jaxcam.data.contents import OLD_SEAL, SEAL
from jaxcam.data.demos import read_demos
from jaxcam.errors import DatasetError
from jaxcam.sim import make_task


def assert_refused(path, match, **expected):
    """Reading fails with that message and leaves the folder as it was."""
    before = {p: p.read_bytes() for p in path.parent.iterdir() if p.is_file()}
    with pytest.raises(DatasetError, match=match) as error:
        read_demos(path, **expected)
    assert {p: p.read_bytes() for p in path.parent.iterdir() if p.is_file()} == before
    assert str(path) in str(error.value)


def unseal(file):
    """Takes both seals off an open dataset."""
    for seal in (OLD_SEAL, SEAL):
        del file["data"].attrs[seal]


def unsealed(demos, folder):
    """Path of a copy of a dataset, without its seal, as a user's own file is."""
    path = folder / demos.path.name
    shutil.copy(demos.path, path)
    with h5py.File(path, "r+") as file:
        unseal(file)
    return path


def spoil(path, change):
    with h5py.File(path, "r+") as file:
        change(file)


def put(file, name, values):
    """Other values, of any shape, for one of a file's arrays."""
    del file[name]
    file[name] = values


def change_all(file, name, change):
    """Other values for an array of every demonstration."""
    for demo in file["data"].values():
        demo[name][...] = change(demo[name][...])


def findings_in(path):
    """Findings on a file by what they are about, without a simulator."""
    return {f.what: f for f in check_dataset(path, 0).findings}


def physics_of(path):
    """Findings on two replayed demonstrations."""
    demos, task = read_demos(path), make_task("lift")
    return {f.what: f for f in check_physics(demos, task, task.scene("randomized"), 2)}
