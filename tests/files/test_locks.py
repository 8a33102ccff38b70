import subprocess
import sys
import time

import pytest
from rich.console import Console

from jaxcam.errors import DatasetError
from jaxcam.files.locks import exclusive

HOLD = """
import sys, time
from pathlib import Path
from jaxcam.locks import exclusive
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
        pytest.raises(DatasetError, match=r"Cannot write to .*--data-dir"),
        exclusive(tmp_path / "file" / "folder" / "data"),
    ):
        pass
