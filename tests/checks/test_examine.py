"""The doctor as a person meets it: exit codes, words, the page, the pictures."""

import re
import shutil
import subprocess
import sys
import time
from dataclasses import replace

import cv2
import h5py
import numpy as np
import pytest
from filmed import filmed
from running import exit_code
from spoilt import unseal

from jaxcam.checks.examine import examine
from jaxcam.checks.findings import worst
from jaxcam.errors import ConfigError, DatasetError, SimError
from jaxcam.sim.tasks.lift import Lift

pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")


def test_a_dataset_from_the_command_line(demos, tmp_path, capsys):
    path = tmp_path / "lift.hdf5"
    shutil.copy(demos.path, path)
    assert exit_code("check", path, "--episodes", 2) == 0
    text = capsys.readouterr().out
    assert demos.fingerprint in text.replace("\n", "")
    assert "replay, eef_delta" in text
    page = (tmp_path / "lift.check.html").read_text("utf-8")
    assert not re.search(r'(src|href)="(?!data:)', page)
    assert page.count("<img") == 3
    assert "To mend" not in page
    assert "command, turn x (rad)" in page
    overlays = cv2.imread(str(tmp_path / "lift.check.png"))
    assert overlays.shape[1] > 2 * 320
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir() if p.suffix == ".hdf5"}
    assert before[path.name] == demos.path.read_bytes()


def test_a_bad_dataset_ends_with_1_and_says_how_to_mend_it(demos, tmp_path, capsys):
    path, page = tmp_path / "lift.hdf5", tmp_path / "other.html"
    shutil.copy(demos.path, path)
    with h5py.File(path, "r+") as file:
        unseal(file)
        poses = file["cameras/world_from_camera"]
        poses[...] = np.linalg.inv(poses[...])
    assert exit_code("check", path, "--episodes", 0, "--out", page) == 1
    text = capsys.readouterr().out
    assert "Likely cause: the matrices map world to camera" in text
    assert "<script" not in page.read_text("utf-8")
    assert "<h2>To mend</h2>" in page.read_text("utf-8")


def test_files_that_are_none(tmp_path, capsys):
    web = tmp_path / "page.hdf5"
    web.write_text("<!DOCTYPE html>")
    assert exit_code("check", web) == 1
    assert "not an HDF5 file" in capsys.readouterr().out
    assert exit_code("check", tmp_path / "none.hdf5") == 3
    assert "neither a dataset nor a run" in capsys.readouterr().err
    assert not list(tmp_path.glob("none*"))
    with pytest.raises(ConfigError, match=r"no config\.json, and no recorded dataset"):
        examine(tmp_path, 1)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder that looks like LeRobot's, which reads as a dataset of a robot that never was."""
    from jaxcam.checks import examine as module

    folder = tmp_path / "cups"
    (folder / "meta").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text("{}")
    asked = []

    def read(path, cameras=None):
        asked.append((path, cameras))
        if cameras is not None and not cameras.exists():
            raise DatasetError(f"{cameras}: there is no such file.")
        return replace(filmed(3, 12), path=path)

    monkeypatch.setattr(module, "read_recording", read)
    return folder, asked


def test_a_recorded_dataset_from_the_command_line(folder, tmp_path, capsys):
    folder, asked = folder
    cameras = tmp_path / "cameras.json"
    cameras.write_text("{}")
    flags = ("--cameras", cameras, "--grip", "observation.state[0:3]")
    assert exit_code("check", folder, *flags) == 0
    assert asked == [(folder, cameras)]
    page = (tmp_path / "cups.check.html").read_text("utf-8")
    assert page.count("<img") == 2
    assert "standing still, view left" in page
    assert [p.name for p in folder.rglob("*")] == ["meta", "info.json"]  # nothing is written there


def test_a_recorded_dataset_that_cannot_be_read_is_bad(folder, capsys):
    folder, _ = folder
    assert exit_code("check", folder, "--cameras", folder / "none.json") == 1
    assert "there is no such file" in capsys.readouterr().out
    assert exit_code("check", folder, "--grip", "state[0:9]") == 2
    assert "--grip names three columns" in capsys.readouterr().err


def test_a_folder_that_cannot_be_written_to_loses_only_the_page(demos, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    out = tmp_path / "file" / "page.html"
    assert exit_code("check", demos.path, "--episodes", 0, "--out", out) == 0
    assert "The page cannot be written" in capsys.readouterr().out


def test_a_simulator_that_is_missing_is_a_note(demos, monkeypatch):
    def require(self):
        raise SimError("pip install 'jaxcam[maniskill]'")

    monkeypatch.setattr(Lift, "require", require)
    report = examine(demos.path, 1)
    assert worst(report.findings) == "note"
    assert report.findings[-1].fix == "pip install 'jaxcam[maniskill]'"
    assert report.overlays is None


@pytest.mark.parametrize(
    ("flags", "match"),
    [
        ([], "Nothing to check"),
        (["x", "--env"], "not both"),
        (["x", "--episodes", "-1"], "least 0"),
    ],
)
def test_bad_flags(monkeypatch, capsys, flags, match):
    assert exit_code("check", *flags) == 2
    assert re.search(match, "".join(capsys.readouterr()))


def test_help_is_fast():
    took = []
    for _ in range(3):  # the best of three: the machine may be busy
        began = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-m", "jaxcam.check", "--help"], capture_output=True, text=True,
            check=True,
        )  # fmt: skip
        took.append(time.perf_counter() - began)
        assert "--episodes" in done.stdout
        if took[-1] < 3:
            return
    pytest.fail(f"--help took {took} s")


def test_the_page_replaces_nothing_that_is_not_its_own(demos, tmp_path, capsys):
    path, mine = tmp_path / "mine.hdf5", tmp_path / "mine.html"
    shutil.copy(demos.path, path)
    mine.write_text("notes")
    (tmp_path / "page.png").write_bytes(b"a picture")
    before = {p: p.read_bytes() for p in tmp_path.iterdir()}
    for out in (path, mine, tmp_path, "/dev/null", tmp_path / "page.html"):
        assert exit_code("check", path, "--episodes", 0, "--out", out) == 2
    assert {p: p.read_bytes() for p in tmp_path.iterdir()} == before
