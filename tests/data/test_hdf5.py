"""HDF5 files that may be anybody's: nothing outside them is read, and no giant is unpacked."""

import os
import subprocess
import sys
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from places import GOLDEN

from jaxcam.data.demos import read_demos
from jaxcam.data.hdf5 import (
    array_at,
    check_total,
    group_at,
    names_at,
    numbers,
    open_hdf5,
    reading,
    text,
)
from jaxcam.errors import DatasetError


def opened(path):
    return open_hdf5(path, remedy="Copy it anew.")


@pytest.fixture
def path(tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["secret"] = np.arange(4.0)
    with h5py.File(tmp_path / "file.h5", "w") as file:
        file["data/numbers"] = np.arange(4)
    return tmp_path / "file.h5"


def link(file, folder):
    file["data/states"] = h5py.ExternalLink(str(folder / "other.h5"), "/secret")


def linked_group(file, folder):
    file["data/demo_0"] = h5py.ExternalLink("other.h5", "/")


def raw(file, folder):
    file.create_dataset("data/states", (4,), "f8", external=[("/etc/passwd", 0, 32)])


def virtual(file, folder):
    layout = h5py.VirtualLayout((4,), "f8")
    layout[:] = h5py.VirtualSource(str(folder / "other.h5"), "secret", (4,))
    file.create_virtual_dataset("data/states", layout)


def virtual_pipe(file, folder):
    os.mkfifo(folder / "pipe")
    layout = h5py.VirtualLayout((4,), "f8", maxshape=(None,))
    layout[:] = h5py.VirtualSource(str(folder / "pipe"), "x", (4,), maxshape=(None,))[:]
    file.create_virtual_dataset("data/states", layout)


@pytest.mark.timeout(30)
@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (link, "data/states is a link to another file"),
        (linked_group, "data/demo_0 is a link to another file"),
        (raw, "data/states is a dataset whose numbers lie in another file"),
        (virtual, "data/states is a virtual dataset"),
        (virtual_pipe, "data/states is a virtual dataset"),
    ],
)
def test_nothing_outside_the_file_is_read(path, spoil, message):
    with h5py.File(path, "r+", libver="latest") as file:
        spoil(file, path.parent)
    with pytest.raises(DatasetError, match=f"{path.name}: {message}.*copy all of it into one"):
        opened(path)


@pytest.mark.parametrize("how", [{"shuffle": True}, {"fletcher32": True}, {}])
def test_packed_arrays_are_read(path, how):
    wanted = np.arange(3000.0).reshape(1000, 3)
    with h5py.File(path, "r+") as file:
        file.create_dataset("packed", data=wanted, compression="gzip", chunks=(300, 3), **how)
        file.create_dataset("other", data=wanted, compression="lzf")
    with opened(path) as file:
        np.testing.assert_array_equal(numbers(file, "packed"), wanted)
        with pytest.raises(DatasetError, match=r"other: packed by HDF5's filters.*with gzip"):
            numbers(file, "other")


def test_links_within_the_file_are_followed(path):
    with h5py.File(path, "r+") as file:
        file["soft"] = h5py.SoftLink("/data/numbers")
        file["data/again"] = file["data"]
        file["broken"] = h5py.SoftLink("/nowhere")
    with opened(path) as file:
        np.testing.assert_array_equal(numbers(file, "soft"), np.arange(4.0))
        np.testing.assert_array_equal(numbers(file, "data/again/numbers"), np.arange(4.0))
        with pytest.raises(DatasetError, match=r"file.h5: no 'broken'\.$"):
            numbers(file, "broken")


def with_kinds(path):
    """A file with something of each kind where something else may be expected."""
    with h5py.File(path, "w") as file:
        file["group/numbers"] = np.arange(3, dtype=np.int16)
        file["words"] = np.array(["a", "b"], "S4")
        file["long"] = np.array(["x" * 300], h5py.string_dtype())
        file["numbers_as_names"] = np.arange(3)
        file["complex"] = np.zeros(3, complex)
        file["table"] = np.zeros(3, [("a", "f4")])
        file["empty"] = h5py.Empty("f8")
        file.create_dataset("sparse", (1 << 40,), "f8", chunks=(1024,))
        file.create_dataset("chunked", (3,), "f8", chunks=(1 << 27,), maxshape=(None,))
        file.attrs.update(text="words", bytes=np.bytes_(b"raw"), number=3, list=["a", "b"])
    return path


@pytest.mark.parametrize(
    ("read", "name", "message"),
    [
        (group_at, "missing", "no 'missing'"),
        (group_at, "words", "words: no group"),
        (array_at, "group", "group: no dataset"),
        (numbers, "missing", "no 'missing'"),
        (numbers, "words", r"words: \|S4; expected numbers"),
        (numbers, "complex", "complex: complex128; expected numbers"),
        (numbers, "table", "table: .*; expected numbers"),
        (numbers, "empty", "empty: float64; expected numbers"),
        (numbers, "sparse", r"sparse: declares 8796093 MB .*at most 67 MB are read"),
        (numbers, "chunked", r"chunked: declares 1074 MB"),
        (text, "missing", "no attribute 'missing'"),
        (text, "number", "attribute 'number' is no text"),
        (text, "list", "attribute 'list' is no text"),
    ],
)
def test_what_is_of_another_kind_or_size_is_told(tmp_path, read, name, message):
    with opened(with_kinds(tmp_path / "kinds.h5")) as file:
        with pytest.raises(DatasetError, match=f"kinds.h5: {message}") as error:
            read(file, name)
        assert "synchronously" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "most", "message"),
    [
        ("words", 1, "2 names, but only 1 exist"),
        ("long", 5, "entry 0 is no name"),
        ("numbers_as_names", 5, "expected a list of names"),
        ("sparse", 5, "declares"),
    ],
)
def test_lists_of_names(tmp_path, name, most, message):
    with opened(with_kinds(tmp_path / "kinds.h5")) as file:
        assert names_at(file, "words", 2) == ["a", "b"]
        with pytest.raises(DatasetError, match=f"{name}: .*{message}"):
            names_at(file, name, most)


def test_what_is_as_expected_is_read(tmp_path):
    with opened(with_kinds(tmp_path / "kinds.h5")) as file:
        assert numbers(group_at(file, "group"), "numbers").tolist() == [0.0, 1.0, 2.0]
        assert (text(file, "text"), text(file, "bytes")) == ("words", "raw")


def test_words_of_the_library_are_not_shown(path):
    for read in (lambda f: f["data/states"], lambda f: f["data"].attrs["states"]):
        with opened(path) as file, pytest.raises(DatasetError) as error, reading(path, "Copy it."):
            read(file)
        assert str(error.value) == f"{path}: no 'states' in it. Copy it."


def test_a_file_declares_no_more_than_it_can_hold(path):
    size = path.stat().st_size
    check_total(path, (1 << 26) + 20 * size)
    with pytest.raises(DatasetError, match=r"declare 67 MB, but the file has 0\.0 MB"):
        check_total(path, (1 << 26) + 20 * size + 1)


def giant(path, kind):
    """A small file that unpacks to gigabytes."""
    shape, how = (1 << 23, 32), {"chunks": (1 << 18, 32)}
    with h5py.File(path, "r+") as file:
        name = "data/demo_0/states"
        if kind == "names":
            name, shape = "mask/train", (1 << 28,)
            how = {"chunks": (1 << 20,)}
        if kind == "cameras":
            name, shape = "cameras/world_from_camera", (1 << 24, 4, 4)
            how = {"chunks": (1 << 16, 4, 4)}
        if kind == "model":
            del file["data/demo_0"].attrs["model_file"]
            file["data/demo_0"].attrs["model_file"] = "<mujoco>" + "<a/>" * (1 << 21)
            return
        if kind in ("packed", "bomb"):
            how["compression"] = "gzip"
        if kind == "bomb":
            shape = (32, 32)
            how["chunks"] = (32, 32)
        if name in file:
            del file[name]
        dtype = "S8" if kind == "names" else "f8"
        made = file.create_dataset(name, shape, dtype, **how)
        if kind == "packed":
            made.id.write_direct_chunk((0, 0), zlib.compress(bytes(1 << 26)))
        if kind == "bomb":
            made.id.write_direct_chunk((0, 0), bomb(200 << 24))


def bomb(size):
    """Zeros of a multiple of 16 MB as zlib packs them; one such part is packed, and repeated."""
    packer = zlib.compressobj(wbits=-zlib.MAX_WBITS)
    part = packer.compress(bytes(1 << 24)) + packer.flush(zlib.Z_FULL_FLUSH)
    checksum = (size % 65521) << 16 | 1  # Adler-32 of zeros
    return b"\x78\x9c" + part * (size >> 24) + b"\x03\x00" + checksum.to_bytes(4, "big")


PEAK = """
import sys
from pathlib import Path
from jaxcam.errors import DatasetError
from jaxcam.interop.formats import read
try:
    read(Path(sys.argv[1]), Path(sys.argv[2]))
    print("read")
except DatasetError as error:
    print(error)
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(int(peak.split()[1]) // 1024)  # getrusage would count the parent from before exec, too
"""


def theirs(path):
    """One demonstration in robomimic's layout."""
    parts = np.load(GOLDEN / "robomimic_lift_1.5.npz")
    with h5py.File(path, "w", libver="latest") as file:
        demo = file.create_group("data/demo_0")
        file["data"].attrs["env_args"] = str(parts["env_args"])
        demo.attrs["model_file"] = str(parts["model_0"])
        demo["states"], demo["actions"] = parts["states_0"], parts["actions_0"]
    return path


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("whose", "kind", "message"),
    [
        ("theirs", "declared", "declare"),
        ("theirs", "packed", "declare"),
        ("theirs", "bomb", "data/demo_0/states: a chunk declares 8196 bytes"),
        ("ours", "bomb", "data/demo_0/states: a chunk declares 8196 bytes"),
        ("theirs", "names", "mask/train: declares"),
        ("theirs", "model", "over 20000 elements"),
        ("ours", "declared", "its arrays declare"),
        ("ours", "packed", "its arrays declare"),
        ("ours", "cameras", "its arrays declare"),
    ],
)
def test_giants_take_no_memory(tmp_path, demos, whose, kind, message):
    path = tmp_path / "giant.hdf5"
    if whose == "ours":
        path.write_bytes(demos.path.read_bytes())
        assert read_demos(path).fingerprint == demos.fingerprint
    else:
        theirs(path)
    giant(path, kind)
    assert path.stat().st_size < 1 << 26
    ran = subprocess.run(
        [sys.executable, "-c", PEAK, path, tmp_path / "out.hdf5"], capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stderr
    *said, megabytes = ran.stdout.splitlines()
    assert "giant.hdf5" in " ".join(said)
    assert message in " ".join(said)
    assert int(megabytes) < 1500
    assert not Path(tmp_path / "out.hdf5").exists()
