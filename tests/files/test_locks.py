"""Locks: who waits, who is told, and what frees them."""

import io
import os
import subprocess
import sys
import time

import pytest
from rich.console import Console
from rights import no_rights

from jaxcam.errors import DatasetError
from jaxcam.files.locks import InUseError, NamedLock, exclusive

HOLD = """
import sys, time
from pathlib import Path
from jaxcam.files.locks import exclusive
with exclusive(Path(sys.argv[1])):
    print("in", flush=True)
    time.sleep(float(sys.argv[2]))
    Path(sys.argv[1]).write_text("made")
"""


def hold(path, seconds):
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(path), str(seconds)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "in\n"
    return process


def test_a_second_process_waits_and_finds_what_the_first_made(tmp_path):
    path = tmp_path / "data" / "file"
    with hold(path, 0.5) as process, exclusive(path, Console(quiet=True)):
        assert path.read_text() == "made"
        process.wait(5)


def test_who_waits_is_told(tmp_path):
    path, words = tmp_path / "file", io.StringIO()
    with hold(path, 0.5), exclusive(path, Console(file=words)):
        assert words.getvalue() == "Waiting for the process that is making file.\n"
    with exclusive(path, Console(file=words)):
        assert words.getvalue().count("Waiting") == 1


def test_a_killed_holder_frees_the_lock(tmp_path):
    path = tmp_path / "file"
    with hold(path, 60) as process:
        process.kill()
        began = time.monotonic()
        with exclusive(path):
            assert time.monotonic() - began < 5
    assert not path.exists()


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(DatasetError, match=r"Cannot write to .*choose another place"),
        exclusive(tmp_path / "file" / "folder" / "data"),
    ):
        pass


def test_a_folder_that_may_not_be_written_to(tmp_path):
    folder = tmp_path / "read-only"
    folder.mkdir(mode=0o555)
    with (
        no_rights(),
        pytest.raises(DatasetError, match=r"Cannot write to .*read-only: Permission denied"),
        exclusive(folder / "data"),
    ):
        pass


def test_a_named_lock_says_who_has_it_and_who_left_it(tmp_path):
    path = tmp_path / "lock"
    first, second = NamedLock(path), NamedLock(path)
    assert first.take() == ""
    with pytest.raises(InUseError, match=f"pid {os.getpid()} on ") as refused:
        second.take()
    assert refused.value.holder == path.read_text().strip()  # and it is still there
    first.free()
    first.free()
    assert path.read_text() == ""
    path.write_text("pid 7 on far\n")  # as a killed process leaves it
    assert second.take() == "pid 7 on far"
    second.free()


def test_a_file_of_somebody_elses_is_no_lock(tmp_path):
    """Such as a lock of another program in a folder that is given as --run-dir."""
    file = tmp_path / "lock"
    file.write_text("my notes")
    with pytest.raises(OSError, match="no lock of ours"):
        NamedLock(file).take()
    assert file.read_text() == "my notes"
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(OSError, match="regular"):
        NamedLock(file).take()
    assert NamedLock(file).held_by() == ""
