"""Files of any format, and paths that lead to no file: each is told for what it is."""

import os
import socket

import h5py
import pytest
from running import exit_code

from jaxcam.config.datasets import ManiskillConfig, RobomimicConfig
from jaxcam.data.demos import faults_of, read_demos
from jaxcam.errors import DatasetError
from jaxcam.interop.formats import read, recognise
from jaxcam.interop.maniskill_files import read_source
from jaxcam.interop.robomimic import import_demos

READERS = {
    "jaxcam": read_demos,
    "its faults": faults_of,
    "any format": read,
    "robomimic": lambda path: import_demos(RobomimicConfig(str(path))),
    "maniskill": lambda path: read_source(ManiskillConfig(str(path))),
}
NO_FILES = {
    "nothing": "no such",
    "folder": "a folder; expected a file",
    "pipe": "a pipe, socket or device; expected a file",
    "socket": "a pipe, socket or device; expected a file",
    "device": "a pipe, socket or device; expected a file",
    "empty": r"an empty file \(0 bytes\)",
    "file/below": "no such",
    "endless": "cannot be opened: File name too long",
}
COMMANDS = {
    "train": ["--dataset"],
    "replay": [],
    "robomimic": [],
    "maniskill": [],
    "lerobot": [],
}


def no_file(folder, kind):
    """A path that leads to no file that can be read."""
    path = folder / kind
    match kind:
        case "folder":
            path.mkdir()
        case "pipe":
            os.mkfifo(path)
        case "socket":
            with socket.socket(socket.AF_UNIX) as there:
                there.bind(kind)  # in the working directory: names of sockets are short
        case "device":
            path.symlink_to("/dev/zero")
        case "empty":
            path.touch()
        case "file/below":
            path.parent.write_text("a file")
        case "endless":
            path = folder / ("x" * 300)
    return path


@pytest.mark.timeout(60)
@pytest.mark.parametrize("kind", NO_FILES)
@pytest.mark.parametrize("reader", READERS)
def test_a_path_to_no_file_is_told(tmp_path, monkeypatch, kind, reader):
    monkeypatch.chdir(tmp_path)
    path = no_file(tmp_path, kind)
    with pytest.raises(DatasetError, match=NO_FILES[kind]) as error:
        READERS[reader](path)
    assert str(error.value).startswith(str(path))
    assert recognise(path) == "unknown"


@pytest.mark.timeout(120)
@pytest.mark.parametrize("kind", ["nothing", "folder", "pipe", "empty"])
@pytest.mark.parametrize("command", COMMANDS)
def test_commands_say_so(tmp_path, monkeypatch, capsys, command, kind):
    monkeypatch.chdir(tmp_path)
    more = ["out"] if command == "lerobot" else []
    assert exit_code(command, *COMMANDS[command], no_file(tmp_path, kind), *more) == 3
    is_recorded = (command, kind) == ("train", "folder")
    words = "no recorded dataset" if is_recorded else NO_FILES[kind].split(" \\")[0]
    assert words in " ".join(capsys.readouterr().err.replace("│", " ").split())


@pytest.mark.parametrize("kind", ["pipe", "empty"])
def test_the_doctor_says_so(tmp_path, monkeypatch, capsys, kind):
    monkeypatch.chdir(tmp_path)
    assert exit_code("check", no_file(tmp_path, kind)) == 1
    assert "It cannot be used" in (tmp_path / f"{kind}.check.html").read_text()


def test_json_beside_trajectories_that_is_no_file(tmp_path):
    path = tmp_path / "made.h5"
    with h5py.File(path, "w") as file:
        file.create_group("traj_0")
    assert recognise(path) == "maniskill"
    os.mkfifo(tmp_path / "made.json")
    with pytest.raises(DatasetError, match=r"made.json: a pipe"):
        read(path)


def test_formats_are_told_by_their_layout(demos, tmp_path):
    assert recognise(demos.path) == "jaxcam"
    assert read(demos.path).fingerprint == demos.fingerprint
    path = tmp_path / "theirs.hdf5"
    for attribute, name in (("env_args", "robomimic"), ("env", "robosuite")):
        with h5py.File(path, "w") as file:
            file.create_group("data").attrs[attribute] = "{}"
        assert recognise(path) == name
    with pytest.raises(DatasetError, match="robosuite's own recording"):
        read(path)
