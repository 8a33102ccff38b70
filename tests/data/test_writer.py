"""The writer of datasets: it loses no finished episode, whatever ends it."""

import os
import shutil
import signal
import subprocess
import sys
from collections import namedtuple

import h5py
import numpy as np
import pytest
from conftest import TINY
from killed_writer import EPISODES, header, require_equal, tiny, write
from many_cameras import with_errors
from places import TESTS

from jaxcam.config.datasets import CollectConfig
from jaxcam.data.collection import collect, dataset_path
from jaxcam.data.demos import fingerprint_of, read_demos
from jaxcam.data.samples import errors_of
from jaxcam.data.writer import DemoWriter, discard, unfinished
from jaxcam.errors import DatasetError
from jaxcam.files.locks import NamedLock

Usage = namedtuple("Usage", "total used free")

KILLED = """
import os, signal, sys
from jaxcam.config.datasets import CollectConfig
from jaxcam.data.collection import collect
from jaxcam.data.writer import DemoWriter
append, replace, count = DemoWriter.append, os.replace, 0
def count_and_append(self, index, demo):
    global count
    count += 1
    append(self, index, demo)
def die_half_way(old, new):
    if count == 4:
        os.kill(os.getpid(), signal.SIGKILL)
    replace(old, new)
DemoWriter.append, os.replace = count_and_append, die_half_way
collect(CollectConfig(demos=4, validation=2, data_dir=sys.argv[1]))
"""


@pytest.mark.timeout(120)
def test_no_kill_loses_a_finished_episode(tmp_path):
    script = [sys.executable, str(TESTS / "killed_writer.py"), "40"]  # it forks: not this process
    done = subprocess.run(script, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "40 kills lost no episode" in done.stdout


def test_errors_are_kept_by_a_writer_that_goes_on_and_are_part_of_what_a_file_is(tmp_path):
    path, plain = tmp_path / "erring.hdf5", tmp_path / "plain.hdf5"
    some = [with_errors(tiny(i), 1, 3) if i % 2 else tiny(i) for i in range(EPISODES)]
    for half in (some[:5], some[5:]):  # the second writer reads what the first one wrote
        with DemoWriter(path, header()) as writer:
            for demo in half:
                writer.append(demo.seed, demo)
    with DemoWriter(path, header()) as writer:
        writer.finish()
    write(plain)
    erring, usual = read_demos(path), read_demos(plain)
    for demo, expected in zip(erring.train, some, strict=True):
        assert (demo.errors is None) == (expected.errors is None)
        if demo.errors is not None:
            assert demo.errors.dtype == bool
            np.testing.assert_array_equal(demo.errors, expected.errors)
    assert erring.fingerprint != usual.fingerprint
    with h5py.File(path) as file:
        assert file["data/demo_1/errors"].fletcher32
        assert "errors" not in file["data/demo_0"]


def test_errors_that_are_none_make_no_other_dataset():
    some = [tiny(0), tiny(1)]
    said = [with_errors(demo, 2, 2) for demo in some]
    assert fingerprint_of(header(), said) == fingerprint_of(header(), some)
    assert errors_of(said) is None


def test_a_killed_collection_ends_as_an_uninterrupted_one(demos, tmp_path, monkeypatch):
    done = subprocess.run(
        [sys.executable, "-c", KILLED, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    config = CollectConfig(**TINY, data_dir=str(tmp_path))
    part = unfinished(dataset_path(config))
    assert not dataset_path(config).exists()
    with DemoWriter(dataset_path(config), demos.header) as writer:
        assert writer.done == {0, 1, 2}  # the fourth was being written
        with pytest.raises(DatasetError, match=r"\[3, 4, 5\]"):
            writer.finish()
    collected = []
    append = DemoWriter.append

    def counting(self, index, demo):
        collected.append(index)
        append(self, index, demo)

    monkeypatch.setattr(DemoWriter, "append", counting)
    resumed = collect(config)
    assert sorted(collected) == [3, 4, 5]  # what is on disk is kept, not collected again
    assert resumed.fingerprint == demos.fingerprint
    assert not part.exists()
    with h5py.File(resumed.path) as file:
        assert file["data"].attrs["total"] == sum(d.length for d in demos.episodes)
    for a, b in zip(resumed.episodes, demos.episodes, strict=True):
        np.testing.assert_array_equal(a.eef_pos, b.eef_pos)
        np.testing.assert_array_equal(a.eef_quat, b.eef_quat)
        assert a.seed == b.seed


def test_unfinished_dataset_of_other_settings(tmp_path):
    path = tmp_path / "some.hdf5"
    with DemoWriter(path, header()) as writer:
        writer.append(0, tiny(0))
    before = {p.name: p.read_bytes() for p in unfinished(path).iterdir()}
    other = type(header())(**{**header().__dict__, "scene": "randomized", "n": 2})
    with pytest.raises(DatasetError, match="scene: file fixed, asked randomized, n: file 1, asked"):
        DemoWriter(path, other)
    after = {p.name: p.read_bytes() for p in unfinished(path).iterdir()}
    assert {**after, "lock": b""} == {**before, "lock": b""}


@pytest.mark.parametrize("content", [b"", b"PK", b"half of a zip", None])
def test_an_episode_that_is_damaged_is_collected_again_and_told(tmp_path, caplog, content):
    path = tmp_path / "some.hdf5"
    with DemoWriter(path, header()) as writer:
        for i in range(3):
            writer.append(i, tiny(i))
    file = unfinished(path) / "demo_1.npz"
    whole = file.read_bytes()
    middle = len(whole) // 2
    flipped = whole[:middle] + bytes([whole[middle] ^ 4]) + whole[middle + 1 :]
    file.write_bytes(flipped if content is None else content)
    (unfinished(path) / ".demo_7.npz.123").write_bytes(b"torn")
    with DemoWriter(path, header()) as writer:
        assert writer.done == {0, 2}
        assert not (writer.part / ".demo_7.npz.123").exists()
    assert "demo_1.npz: damaged" in caplog.text
    write(path)
    require_equal(read_demos(path))
    assert os.listdir(tmp_path) == [path.name]


def test_a_header_that_is_damaged_is_told(tmp_path):
    path = tmp_path / "some.hdf5"
    with DemoWriter(path, header()):
        pass
    (unfinished(path) / "header.npz").write_bytes(b"PK")
    with pytest.raises(DatasetError, match=r"cannot be read.*Delete the folder some.hdf5.part"):
        DemoWriter(path, header())


@pytest.fixture
def of_0_1(tmp_path):
    """What version 0.1.0 left: a file with three episodes, of which the last is torn."""
    path = tmp_path / "old.hdf5"
    write(path)
    path.rename(unfinished(path))
    with h5py.File(unfinished(path), "r+") as file:
        for i in range(3, EPISODES):
            del file[f"data/demo_{i}"]
        del file["data/demo_2"].attrs["num_samples"]
        for seal in ("sha256", "sha256_of_all"):
            del file["data"].attrs[seal]
    return path


def test_episodes_of_an_unfinished_file_of_0_1_are_taken_over(of_0_1):
    with DemoWriter(of_0_1, header()) as writer:
        assert writer.done == {0, 1}
        assert unfinished(of_0_1).is_dir()
    write(of_0_1)
    require_equal(read_demos(of_0_1))
    assert os.listdir(of_0_1.parent) == [of_0_1.name]


def test_an_unfinished_file_of_0_1_of_other_settings_stays(of_0_1):
    part = unfinished(of_0_1)
    before = part.read_bytes()
    other = type(header())(**{**header().__dict__, "n": 2})
    with pytest.raises(DatasetError, match="n: file 1, asked 2"):
        DemoWriter(of_0_1, other)
    assert part.read_bytes() == before
    part.write_bytes(before[:5000])
    with pytest.raises(DatasetError, match=r"unfinished file that cannot be opened.*Delete"):
        DemoWriter(of_0_1, header())
    assert part.stat().st_size == 5000


def test_an_unfinished_file_that_0_1_is_writing(of_0_1):
    code = (
        "import sys, h5py, time\n"
        "file = h5py.File(sys.argv[1], 'r+')\n"
        "print('open', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(unfinished(of_0_1))],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    ) as other:  # fmt: skip
        assert other.stdout.readline() == b"open\n"
        with pytest.raises(DatasetError, match="in use by another process"):
            DemoWriter(of_0_1, header())
        other.stdin.close()


def test_two_processes_do_not_write_one_dataset(tmp_path):
    path = tmp_path / "both.hdf5"
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "from pathlib import Path\n"
        "from killed_writer import header\n"
        "from jaxcam.data.writer import DemoWriter\n"
        "DemoWriter(Path(sys.argv[2]), header())"
    )
    with DemoWriter(path, header()):
        done = subprocess.run(
            [sys.executable, "-c", code, str(TESTS), str(path)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert f"in use by another process (pid {os.getpid()} on" in done.stderr
        with pytest.raises(DatasetError, match="in use by another process"):
            DemoWriter(path, header())


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    config = CollectConfig(**TINY, data_dir=str(tmp_path / "file" / "data"))
    with pytest.raises(DatasetError, match=r"Cannot write to .*choose another place"):
        collect(config)


def test_a_disk_without_room_is_told_and_keeps_what_is_there(tmp_path, monkeypatch):
    path = tmp_path / "some.hdf5"
    with DemoWriter(path, header()) as writer:
        writer.append(0, tiny(0))
        with monkeypatch.context() as patch:
            patch.setattr(shutil, "disk_usage", lambda _: Usage(10**9, 10**9, 100))
            with pytest.raises(DatasetError, match=r"demo_1.npz: .*are needed.*collected is kept"):
                writer.append(1, tiny(1))
        assert writer.done == {0}
    write(path)
    require_equal(read_demos(path))


LIMITED = """
import resource, sys; sys.path.insert(0, sys.argv[1])
from pathlib import Path
from killed_writer import write
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]), resource.RLIM_INFINITY))
write(Path(sys.argv[2]))
"""


@pytest.mark.parametrize("limit", [0, 100, 5500, 20_000])
def test_a_limit_on_the_size_of_files_is_one_error(tmp_path, limit):
    """HDF5's library ends in a segmentation fault there."""
    path = tmp_path / "some.hdf5"
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, str(TESTS), str(path), str(limit)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert "DatasetError" in done.stderr
    assert "File too large" in done.stderr
    assert not path.exists()
    write(path)
    require_equal(read_demos(path))


def test_what_cannot_be_an_episode_is_not_kept(tmp_path):
    demo = tiny(0)
    demo.states[2, 3] = np.nan
    with DemoWriter(tmp_path / "some.hdf5", header()) as writer:
        with pytest.raises(DatasetError, match="demo_0: non-finite states"):
            writer.append(0, demo)
        assert writer.done == set()


def test_what_others_put_into_the_folder_stays(tmp_path):
    path = tmp_path / "some.hdf5"
    with DemoWriter(path, header()) as writer:
        writer.append(0, tiny(0))
        (writer.part / "notes.txt").write_text("mine")
    discard(path)
    assert os.listdir(unfinished(path)) == ["notes.txt"]


def test_what_others_put_in_the_place_of_an_unfinished_dataset_stays(tmp_path):
    path = tmp_path / "mine.hdf5"
    unfinished(path).write_text("my notes")
    with pytest.raises(DatasetError, match="cannot be opened"):
        discard(path)
    assert unfinished(path).read_text() == "my notes"
    unfinished(path).unlink()
    lock = NamedLock(unfinished(path) / "lock")
    unfinished(path).mkdir()
    (unfinished(path) / "demo_0.npz").write_bytes(b"")
    lock.take()
    with pytest.raises(DatasetError, match="in use by another process"):
        discard(path)
    assert (unfinished(path) / "demo_0.npz").exists()
    lock.free()
    discard(path)
    assert not unfinished(path).exists()
