"""PyTorch's files are read without PyTorch, whatever they ask for."""

import contextlib
import pickle
import struct
import tracemalloc
import zipfile

import ml_dtypes
import numpy as np
import pytest
from places import GOLDEN

from jaxcam.errors import CheckpointError
from jaxcam.models.weights.load import read_weights
from jaxcam.models.weights.torch_files import MOST_STEPS, read_torch

FILES = GOLDEN


@pytest.mark.parametrize("name", ["weights.pth", "weights_legacy.pth"])
def test_torch_files_are_read_without_torch(name):
    arrays = read_torch(FILES / name)
    table = np.arange(24, dtype=np.float32).reshape(4, 6)
    np.testing.assert_array_equal(arrays["net.plain"], table)
    np.testing.assert_array_equal(arrays["net.turned"], table.T[1:3])
    assert arrays["net.scalar"] == 7
    assert arrays["net.scalar"].dtype == np.int64
    assert arrays["net.empty"].shape == (0, 3)
    assert arrays["net.half"].dtype == np.float16
    np.testing.assert_array_equal(arrays["net.half"], [1.5, -2])
    np.testing.assert_array_equal(arrays["net.brain"].astype(np.float32), [1.5, -3])
    np.testing.assert_array_equal(arrays["net.flags"], [True, False])
    np.testing.assert_array_equal(arrays["net.parameter"], [1, 1])
    np.testing.assert_array_equal(arrays["list.0"], [9])
    assert len(arrays) == 9


@pytest.mark.parametrize("name", ["weights_types.pth", "weights_types_legacy.pth"])
def test_types_that_torch_stores_as_bytes(name):
    arrays = read_torch(FILES / name)
    np.testing.assert_array_equal(arrays["uint16"], np.array([2, 60000], np.uint16))
    np.testing.assert_array_equal(arrays["uint64"], np.array([1, 2**40], np.uint64))
    np.testing.assert_array_equal(arrays["complex"], np.array([0.5j, -2j, 3j], np.complex64))
    assert arrays["e4m3"].dtype == ml_dtypes.float8_e4m3fn
    np.testing.assert_array_equal(arrays["e4m3"].astype(np.float32), [-2, 3])
    assert arrays["e5m2"].dtype == ml_dtypes.float8_e5m2
    np.testing.assert_array_equal(arrays["e5m2"].astype(np.float32), [0.5, -2, 3])


class Evil:
    """Runs a command when it is unpickled."""

    def __reduce__(self):
        return print, ("PWNED",)


def test_a_pickle_that_runs_something_is_refused(tmp_path, capsys):
    file = tmp_path / "evil.pth"
    parts = [0x1950A86A20F9469CFC6C, 1001, {"little_endian": True}, {"model": Evil()}]
    file.write_bytes(b"".join(pickle.dumps(part, 2) for part in parts))
    with pytest.raises(CheckpointError, match=r"print.*torch\.save"):
        read_weights(file)
    assert "PWNED" not in capsys.readouterr().out


def test_a_tensor_of_an_unknown_kind_is_not_called_a_program(tmp_path):
    content = b"\x80\x02" + opcodes("a") + b"ctorch._utils\n_rebuild_sparse_tensor\n)R."
    save_archive(tmp_path / "sparse.pth", content)
    with pytest.raises(CheckpointError, match=r"kind that is not read here.*sparse") as error:
        read_weights(tmp_path / "sparse.pth")
    assert "program" not in str(error.value)


def opcodes(value):
    """What pushes a value in a pickle."""
    return pickle.dumps(value, 2)[2:-1]


def tensor(shape, strides, count=4):
    """What pushes a tensor of float32 whose storage is called 0."""
    storage = opcodes("storage") + b"ctorch\nFloatStorage\n" + opcodes("0") + opcodes("cpu")
    about = opcodes(0) + opcodes(shape) + opcodes(strides)
    storage = b"(" + storage + opcodes(count) + b"tQ"
    hooks = b"\x89ccollections\nOrderedDict\n)R"
    return b"ctorch._utils\n_rebuild_tensor_v2\n(" + storage + about + hooks + b"tR"


def save_archive(path, content, storage=bytes(16), compression=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", compression) as archive:
        archive.writestr("archive/data.pkl", content)
        archive.writestr("archive/data/0", storage)


def nested(depth):
    """Lists of ten times the same list, so deep."""
    value = []
    for _ in range(depth):
        value = [value] * 10
    return value


def cyclic():
    value = []
    value.append(value)
    return value


def copied_lists():
    """Many copies of one long list, each of which takes a few bytes of the pickle."""
    long = b"(" + b"K\x01" * 50_000 + b"lq\x07"
    return b"(" + long + b"ctorch\nSize\nh\x07\x85R" * 20_000 + b"l"


HOSTILE = {
    "a stride of 0": tensor((1_500_000_000,), (0,)),
    "many windows of one storage": b"(" + tensor((4096, 4096), (0, 1), 4096) * 40 + b"l",
    "lists inside of lists": opcodes(nested(30)),
    "a list inside of itself": opcodes(cyclic()),
    "a place far away in the memo": b"]r\xff\xff\xff\x7f",
    "copies of a list": copied_lists(),
    "a long name, many times": opcodes({"x" * 10_000: [[]] * 100_000}),
    "a giant text": b"\x8e" + (2**40).to_bytes(8, "little"),
}


@pytest.mark.parametrize("case", HOSTILE)
@pytest.mark.parametrize("layout", ["zip", "legacy"])
def test_memory_stays_near_the_size_of_the_file(tmp_path, case, layout):
    file, content = tmp_path / "hostile.pth", b"\x80\x02" + HOSTILE[case] + b"."
    if layout == "zip":
        save_archive(file, content, bytes(4 * 4096))
    else:
        head = [pickle.dumps(x, 2) for x in (0x1950A86A20F9469CFC6C, 1001, {"little_endian": True})]
        storage = pickle.dumps(["0"], 2) + (4096).to_bytes(8, "little") + bytes(4 * 4096)
        file.write_bytes(b"".join(head) + content + storage)
    with bounded(400e6), pytest.raises(CheckpointError, match=r"more memory|not a whole"):
        read_weights(file)


def test_a_pickle_without_an_end_is_refused_before_it_is_obeyed(tmp_path):
    content = b"\x80\x02(" + b"}" * (MOST_STEPS + 1) + b"l."
    save_archive(tmp_path / "long.pth", content)
    with pytest.raises(CheckpointError, match="more memory"):
        read_weights(tmp_path / "long.pth")


@contextlib.contextmanager
def bounded(most):
    """Fails where more than so many bytes were taken at once."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()


def test_compressed_storages_of_a_giant_are_refused(tmp_path):
    file = tmp_path / "deflated.pth"
    content = b"\x80\x02}" + opcodes("a") + tensor((4, 2), (2, 1), 8) + b"s."
    save_archive(file, content, bytes(100_000_000), zipfile.ZIP_DEFLATED)
    with bounded(50e6), pytest.raises(CheckpointError, match="more memory"):
        read_weights(file)
    save_archive(file, content, np.arange(8, dtype=np.float32).tobytes(), zipfile.ZIP_DEFLATED)
    np.testing.assert_array_equal(read_weights(file).arrays["a"], np.arange(8).reshape(4, 2))


def test_a_small_array_that_repeats_its_numbers_is_read(tmp_path):
    content = b"\x80\x02}" + opcodes("a") + tensor((3, 4), (0, 1)) + b"s."
    save_archive(tmp_path / "expanded.pth", content, np.arange(4, dtype=np.float32).tobytes())
    expected = np.tile(np.arange(4), (3, 1))
    np.testing.assert_array_equal(read_weights(tmp_path / "expanded.pth").arrays["a"], expected)


@pytest.mark.parametrize("name", ["a.pth", "a.safetensors"])
def test_empty_files_and_pointers_are_told(tmp_path, name):
    file = tmp_path / name
    file.write_bytes(b"")
    with pytest.raises(CheckpointError, match="is empty"):
        read_weights(file)
    file.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n")
    with pytest.raises(CheckpointError, match="git lfs pull"):
        read_weights(file)


@pytest.mark.parametrize("name", ["weights.pth", "weights_legacy.pth"])
def test_a_torn_file_is_refused(tmp_path, name):
    whole = (FILES / name).read_bytes()
    for share in (0.2, 0.6, 0.95):
        (tmp_path / name).write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(CheckpointError, match="not a whole PyTorch file"):
            read_torch(tmp_path / name)


@pytest.mark.parametrize("large", [False, True])
def test_an_archive_of_countless_files_is_refused_by_its_directory(tmp_path, large):
    """Whatever count it declares: here one file, in a list of twelve megabytes."""
    size = 12 * 2**20
    end = struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 1, 1, 2**32 - 1 if large else size, 0, 0)
    if large:
        end = (struct.pack("<4sQ2H2L4Q", b"PK\6\6", 44, 45, 45, 0, 0, 1, 1, size, 0)
               + struct.pack("<4sLQL", b"PK\6\7", 0, size, 1) + end)  # fmt: skip
    for name, rest in (("a.pt", end), ("commented.pt", end[:-2] + b"\x09\0a comment")):
        path = tmp_path / name
        path.write_bytes(bytes(size) + rest)
        with pytest.raises(CheckpointError, match="far more memory"):
            read_torch(path)
