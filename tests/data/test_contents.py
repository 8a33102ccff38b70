"""The seal of a dataset covers all that is in it."""

import h5py
import numpy as np
import pytest
from spoilt import assert_refused, put

from jaxcam.data.contents import OLD_SEAL, SEAL
from jaxcam.data.demos import read_demos


@pytest.mark.parametrize(("seal", "other"), [(SEAL, OLD_SEAL), (OLD_SEAL, SEAL)])
def test_another_seed_of_an_episode_breaks_the_seal(copy, demos, seal, other):
    """An attribute has no checksum; whether an episode is the evaluation's is told by its seed."""
    with h5py.File(copy, "r+") as file:
        del file["data"].attrs[other]
    assert read_demos(copy).fingerprint == demos.fingerprint
    with h5py.File(copy, "r+") as file:
        file["data/demo_2"].attrs["seed"] += 1
    assert_refused(copy, rf"damaged: its content is not what was written.* \({seal}\)")


CHANGES = {
    "the grip moved by 5 cm": lambda f: shift(f, "data/demo_1/obs/robot0_eef_pos", 0.05),
    "the grip in another order": lambda f: reverse(f, "data/demo_1/obs/robot0_eef_pos"),
    "the grip mirrored": lambda f: scale(f, "data/demo_1/obs/robot0_eef_pos", -1),
    "a quaternion negated": lambda f: scale(f, "data/demo_1/obs/robot0_eef_quat", -1),
    "the gripper turned": lambda f: scale(f, "data/demo_5/obs/robot0_gripper", -1),
    "a larger cube": lambda f: scale(f, "data/demo_0/start/geom_size", 1.01),
    "another place of the table": lambda f: shift(f, "data/demo_0/start/fixtures", 1e-6),
    "a state": lambda f: scale(f, "data/demo_0/states", 1 + 1e-9),
    "a command": lambda f: scale(f, "data/demo_0/actions", 1 + 1e-9),
    "a camera": lambda f: shift(f, "cameras/world_from_camera", 1e-9),
    "errors where there were none": lambda f: f["data/demo_0"].create_dataset(
        "errors", data=np.arange(len(f["data/demo_0/actions"])) < 3
    ),
    "states of less precision": lambda f: put(
        f, "data/demo_0/states", f["data/demo_0/states"][:].astype("f4")
    ),
    "a mask": lambda f: put(f, "mask/train", [b"demo_5", b"demo_1"]),
    "no mask": lambda f: f.__delitem__("mask/valid"),
    "another field of view": lambda f: f["cameras"].attrs.__setitem__("fovy_deg", 46.0),
    "no field of view": lambda f: f["cameras"].attrs.__delitem__("fovy_deg"),
    "another length": lambda f: f["data/demo_1"].attrs.__setitem__("num_samples", 3),
    "another total": lambda f: f["data"].attrs.__setitem__("total", 3),
    "other settings of robomimic": lambda f: f["data"].attrs.__setitem__("env_args", "{}"),
    "other versions": lambda f: f["data"].attrs.__setitem__(
        "jaxcam", f["data"].attrs["jaxcam"].replace("numpy", "numpi")
    ),
}


def shift(file, name, by):
    file[name][...] += by


def scale(file, name, by):
    file[name][...] *= by


def reverse(file, name):
    file[name][...] = file[name][:][::-1]


@pytest.mark.parametrize("change", CHANGES)
def test_whatever_is_changed_breaks_the_seal(copy, change):
    with h5py.File(copy, "r+") as file:
        CHANGES[change](file)
    assert_refused(copy, "damaged: its content is not what was written")


def test_a_file_of_0_1_has_its_own_seal_only(copy, demos):
    """It is read, and what that seal covers is still checked."""
    with h5py.File(copy, "r+") as file:
        del file["data"].attrs[SEAL]
    assert read_demos(copy).fingerprint == demos.fingerprint
    with h5py.File(copy, "r+") as file:
        shift(file, "data/demo_1/actions", 1e-3)
    assert_refused(copy, rf"damaged: .* \({OLD_SEAL}\)")
