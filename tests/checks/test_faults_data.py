"""Faults of datasets and their pictures, injected one by one, and what is said of each."""

import json
import logging
import shutil
from dataclasses import replace

import h5py
import numpy as np
import pytest
from conftest import PIXELS

from jaxcam.checks.dataset import check_physics
from jaxcam.checks.examine import check_dataset
from jaxcam.checks.pictures import check_caches
from jaxcam.data import pictures as pictures_module
from jaxcam.data.demos import read_demos
from jaxcam.data.pictures import load_pictures
from jaxcam.errors import DatasetError, SimError
from jaxcam.rays._checks import ROTATION_TOLERANCE
from jaxcam.sim import make_task


@pytest.fixture
def copy(demos, tmp_path):
    """The session's dataset in a folder of its own, unsealed as a user's own file is."""
    path = tmp_path / demos.path.name
    shutil.copy(demos.path, path)
    with h5py.File(path, "r+") as file:
        del file["data"].attrs["sha256"]
    return path


def spoil(path, change):
    with h5py.File(path, "r+") as file:
        change(file)


def put(file, name, values):
    """Other values, of any shape, for one of a file's arrays."""
    del file[name]
    file[name] = values


def found_in(path):
    """Findings on a file by what they are about, without a simulator."""
    return {f.what: f for f in check_dataset(path, 0).findings}


def physics_of(path):
    """Findings on two replayed demonstrations."""
    demos, task = read_demos(path), make_task("lift")
    return {f.what: f for f in check_physics(demos, task, task.scene("randomized"), 2)}


def every(file, name, change):
    for demo in file["data"].values():
        demo[name][...] = change(demo[name][...])


def copied(file, old, new):
    del file[f"data/demo_{new}"]
    file.copy(f"data/demo_{old}", f"data/demo_{new}")


def header(file, **values):
    about = json.loads(file["data"].attrs["jaxcam"])
    file["data"].attrs["jaxcam"] = json.dumps({**about, **values})


def test_a_whole_dataset_has_nothing_to_mend(copy):
    found = found_in(copy) | physics_of(copy)
    assert {f.mark for f in found.values()} == {"good"}, found
    assert {"file", "duplicates", "cameras", "replay, joint_abs", "grip"} <= set(found)


CASES = {
    "a copy": (lambda f: copied(f, 0, 2), "duplicates", "bad", "1 are copies"),
    "a leak": (
        lambda f: copied(f, 0, 5), "duplicates", "bad", "1 of them validation copies of training",
    ),
    "a seed twice": (
        lambda f: f["data/demo_1"].attrs.__setitem__("seed", f["data/demo_0"].attrs["seed"]),
        "duplicates", "note", "1 more share an episode's seed",
    ),
    "a gripper from 0 to 1": (
        lambda f: every(f, "actions", lambda a: np.hstack([a[:, :6], (a[:, 6:] + 1) / 2])),
        "gripper", "bad", "0 to 1",
    ),
    "a gripper in millimetres": (
        lambda f: every(f, "actions", lambda a: np.hstack([a[:, :6], a[:, 6:] * 40])),
        "gripper", "bad", "-40 to 40",
    ),
    "a gripper that never moves": (
        lambda f: every(f, "actions", lambda a: np.hstack([a[:, :6], 0 * a[:, 6:] - 1])),
        "gripper", "note", "never changes",
    ),
    "a constant": (
        lambda f: every(f, "actions", lambda a: a * (np.arange(7) != 4)),
        "constant commands", "note", "turn y",
    ),
    "commands in millimetres": (
        lambda f: every(f, "actions", lambda a: a * ([1000] * 3 + [1] * 4)),
        "commands", "bad", "m from where the grip",
    ),
    "deltas": (
        lambda f: every(
            f, "actions",
            lambda a: np.hstack([np.diff(a[:, :3], axis=0, prepend=a[:1, :3]), a[:, 3:]]),
        ),
        "commands", "bad", "m from where the grip",
    ),
    "a leap": (
        lambda f: f["data/demo_3/actions"].__setitem__((20, 0), 0.5), "commands", "note", "leap",
    ),
    "another rate": (
        lambda f: every(f, "states", lambda s: s * ([2] + [1] * (s.shape[1] - 1))),
        "rate", "bad", "0.1 to 0.1 s apart",
    ),
    "a short one": (
        lambda f: [
            put(f, f"data/demo_1/{name}", f[f"data/demo_1/{name}"][: 6 + (name != "actions")])
            for name in (
                "states", "actions", "obs/robot0_eef_pos", "obs/robot0_eef_quat",
                "obs/robot0_gripper",
            )
        ],
        "lengths", "note", "6 to ",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_what_is_odd_is_found(copy, case):
    change, what, mark, words = CASES[case]
    assert found_in(copy)[what].mark == "good"
    spoil(copy, change)
    found = found_in(copy)[what]
    assert found.mark == mark, found
    assert words in found.got


UNUSABLE = {
    "no steps": (
        lambda f: [put(f, "data/demo_1/actions", np.zeros((0, 7))),
                   put(f, "data/demo_1/states", f["data/demo_1/states"][:1])],
        "0 actions need 1 states",
    ),
    "no number in a state": (
        lambda f: f["data/demo_1/states"].__setitem__((4, 3), np.nan),
        r"non-finite states: 1 of \d+ numbers, the first at step 4",
    ),
    "no number in the grip": (
        lambda f: f["data/demo_1/obs/robot0_eef_pos"].__setitem__((4, 1), np.inf),
        "non-finite eef_pos",
    ),
    "other actions": (
        lambda f: put(f, "data/demo_1/actions", f["data/demo_1/actions"][:, :6]),
        r"actions is \[\d+, 6\], expected \[\d+, 7\]",
    ),
    "other states": (
        lambda f: put(f, "data/demo_1/states", f["data/demo_1/states"][:, 1:]), "states is",
    ),
    "poses of another shape": (
        lambda f: put(f, "cameras/world_from_camera", np.zeros((8, 3, 4))),
        r"world_from_camera is \[8, 3, 4\]",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", UNUSABLE)
def test_what_cannot_be_used_is_refused(copy, case):
    change, words = UNUSABLE[case]
    spoil(copy, change)
    with pytest.raises(DatasetError, match=words):
        read_demos(copy)
    assert found_in(copy)["file"].mark == "bad"


def test_every_bad_demonstration_is_listed(copy):
    spoil(copy, lambda f: [f[f"data/demo_{i}/actions"].__setitem__(0, np.nan) for i in (0, 3)])
    spoil(copy, lambda f: f.__delitem__("data/demo_4/states"))
    findings = check_dataset(copy, 0).findings
    assert [f.mark for f in findings] == ["bad"] * 3
    for finding, name in zip(findings, ("demo_0", "demo_3", "demo_4"), strict=True):
        assert name in finding.got


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
    def rounded(file, digits):
        poses = file["cameras/world_from_camera"]
        poses[...] = np.round(poses[...], digits)

    spoil(copy, lambda f: rounded(f, 4))
    with caplog.at_level(logging.WARNING):
        poses = read_demos(copy).header.world_from_camera
    assert len(caplog.records) == 1
    assert "rotations of 8 of 8 cameras are rounded" in caplog.text
    rotation = poses[:, :3, :3]
    error = abs(rotation.swapaxes(-1, -2) @ rotation - np.eye(3)).max()
    assert error < 1e-12 < ROTATION_TOLERANCE
    spoil(copy, lambda f: rounded(f, 2))  # what is worse is left for the check of cameras to refuse
    assert found_in(copy)["camera poses"].mark == "bad"


def test_a_rounded_mirror_stays_a_mirror(copy):
    def mirror(file):
        poses = file["cameras/world_from_camera"]
        poses[...] = np.round(poses[...], 4) @ np.diag([1.0, -1, 1, 1])

    spoil(copy, mirror)
    assert "8 of 8 cameras" in found_in(copy)["camera poses"].got


def test_commands_that_no_longer_do_what_they_did(copy):
    spoil(copy, lambda f: every(f, "actions", lambda a: a * ([1] * 6 + [-1])))
    found = physics_of(copy)
    assert found["replay, eef_abs"].mark == "bad"
    assert found["replay, eef_abs"].where == "demo_0, demo_5"
    assert "0 of 2 succeed" in found["replay, joint_delta"].got
    assert "gripper's sign" in found["replay, eef_abs"].fix


def test_objects_that_are_not_where_they_were(copy, scene):
    shift = np.zeros(1 + scene.nq + scene.nv)
    shift[1 + scene.qpos_of("cube")] = 0.06
    spoil(copy, lambda f: every(f, "states", lambda s: s + shift))
    found = physics_of(copy)
    assert found["replay, joint_abs"].mark == "bad"
    assert "object poses" in found["replay, joint_abs"].fix
    assert found["grip"].mark == "good"


def test_a_grip_that_is_not_where_the_joints_put_it(copy):
    spoil(copy, lambda f: every(f, "obs/robot0_eef_pos", lambda p: p + np.array([0.02, 0, 0])))
    found = physics_of(copy)["grip"]
    assert found.mark == "bad"
    assert "within 20 mm" in found.got


@pytest.fixture
def cached(demos, pictures, tmp_path):
    """The dataset and its pictures in a folder of their own, and those pictures to be changed."""
    path = tmp_path / demos.path.name
    shutil.copy(demos.path, path)
    (folder := tmp_path / "frames").mkdir()
    (source,) = (demos.path.parent / "frames").glob(f"*-{PIXELS}px-*.npy")
    shutil.copy(source, folder)
    cache = folder / source.name
    return replace(demos, path=path), cache, np.lib.format.open_memmap(cache, "r+")


@pytest.fixture
def pictures_of(lift, scene, renderer, monkeypatch):
    """Findings on a dataset's pictures; the session's renderer draws."""
    monkeypatch.setattr(type(scene), "painter", lambda *args, **kwargs: renderer)
    return lambda demos: list(check_caches(demos, lift, scene, 3))


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda x: x[..., ::-1], "BGR"),
        (lambda x: x[:, ::-1], "bottom row is first"),
        (lambda x: x[:, :, ::-1], "left and right"),
        (lambda x: x[:, ::-1, ::-1], "upside down"),
        (lambda x: np.rot90(x, 1, (1, 2)), "by 90"),
        (lambda x: np.roll(x, 40, 0), "Delete"),
    ],
)
def test_pictures_that_show_something_else(cached, pictures_of, change, cause):
    demos, _, pictures = cached
    assert [f.mark for f in pictures_of(demos)] == ["good", "good"]
    pictures[...] = change(pictures[...].copy())
    pictures.flush()
    blank, found = pictures_of(demos)
    assert (blank.mark, found.mark) == ("good", "bad"), found
    assert cause in found.fix


def test_blank_and_frozen_pictures(cached, pictures_of):
    demos, cache, pictures = cached
    _, second, third = load_pictures(demos, PIXELS).layout.first[:3]
    pictures[0] = 0
    pictures[second:third] = pictures[second]
    pictures.flush()
    found, _ = pictures_of(demos)
    assert found.mark == "bad"
    assert "frame 0" in found.where
    assert "demo_1" in found.where
    assert str(cache) in found.fix


def test_pictures_of_other_content_are_told_and_not_used(cached, pictures_of):
    demos, cache, _ = cached
    other = cache.with_name(cache.name.replace(demos.fingerprint, "0" * 16))
    cache.rename(other)
    (found,) = pictures_of(demos)
    assert (found.mark, found.where) == ("note", other.name)


def test_of_pictures_drawn_in_part_those_that_are_drawn_are_compared(cached, pictures_of):
    demos, cache, pictures = cached
    part, flags = cache.with_suffix(".part"), cache.with_suffix(".drawn")
    cache.rename(part)
    (found,) = pictures_of(demos)
    assert (found.mark, found.got, found.where) == ("note", "none drawn yet", part.name)
    drawn = np.arange(len(pictures)) % 3 == 0
    drawn.tofile(flags)
    pictures[~drawn] = 0
    pictures.flush()
    looked, same = pictures_of(demos)
    assert (looked.mark, same.mark) == ("good", "good")
    assert f"{drawn.sum()} of {len(drawn)} frames are drawn" in looked.got
    pictures[:] = pictures[..., ::-1]
    pictures.flush()
    _, swapped = pictures_of(demos)
    assert swapped.mark == "bad"
    assert "BGR" in swapped.fix


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c, x: c.write_bytes(c.read_bytes()[:5000]), "5000 bytes that cannot be read"),
        (lambda c, x: c.write_bytes(b""), "0 bytes that cannot be read"),
        (lambda c, x: np.save(c, x[:, :12]), r"should be uint8 .* but are uint8 .*12, 24, 3"),
        (lambda c, x: np.save(c, x[:-1]), "should be uint8"),
        (lambda c, x: np.save(c, x / np.float32(255)), "but are float32"),
    ],
)
def test_a_cache_that_is_not_what_was_written_is_refused(cached, change, words):
    demos, cache, pictures = cached
    change(cache, np.array(pictures))
    with pytest.raises(DatasetError, match=words) as error:
        load_pictures(demos, PIXELS)
    assert f"{cache}: " in str(error.value)
    assert "Delete the file; they are drawn anew" in str(error.value)


class Blackout:
    """A renderer whose first pictures are black."""

    def __init__(self, times):
        self.times = times

    def __call__(self, *args):
        made = REAL(*args)
        if self.times == 0:
            return made
        self.times -= 1
        return type("Black", (), {"rgb": lambda _, view: 0 * made.rgb(view)})()

    def cache_clear(self):
        REAL.cache_clear()


REAL = pictures_module._renderer


def test_black_pictures_are_drawn_by_another_renderer_once(demos, pictures, tmp_path, monkeypatch):
    elsewhere = replace(demos, path=tmp_path / demos.path.name)
    monkeypatch.setattr(pictures_module, "_renderer", Blackout(1))
    np.testing.assert_array_equal(load_pictures(elsewhere, PIXELS).rgb, pictures.rgb)


def test_pictures_that_stay_black_are_refused(demos, tmp_path, monkeypatch):
    elsewhere = replace(demos, path=tmp_path / demos.path.name)
    monkeypatch.setattr(pictures_module, "_renderer", Blackout(2))
    with pytest.raises(SimError, match="of one colour, and again with another renderer"):
        load_pictures(elsewhere, PIXELS)
    assert not list((tmp_path / "frames").glob("*.npy"))
