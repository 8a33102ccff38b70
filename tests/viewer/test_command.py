"""`python -m jaxcam.view`, from the flags to the page."""

import json
import subprocess
import sys
import threading
import urllib.request

import numpy as np
import pytest
from running import exit_code

from jaxcam.files.whole import MARK

VIEW = {
    "K": {"fx": 60, "fy": 60, "cx": 32, "cy": 24}, "size": [64, 48],
    "base_from_camera": np.eye(4).tolist(),
}  # fmt: skip


@pytest.fixture
def cameras(tmp_path):
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps({"format": 1, "views": {"front": VIEW}}))
    return path


def test_a_page_is_saved(cameras, tmp_path, capsys):
    page = tmp_path / "page.html"
    assert exit_code("view", cameras, "--save", page) == 0
    assert MARK in page.read_text("utf-8")
    assert "MB" in capsys.readouterr().out
    assert exit_code("view", cameras, "--save", page) == 0  # again in its own place


def test_nothing_else_is_overwritten(cameras, tmp_path, capsys):
    (tmp_path / "mine.html").write_text("mine")
    assert exit_code("view", cameras, "--save", tmp_path / "mine.html") == 2
    assert exit_code("view", cameras, "--save", cameras) == 2
    assert (tmp_path / "mine.html").read_text() == "mine"


def test_an_episode_that_is_not_there_is_told(cameras, capsys):
    assert exit_code("view", cameras, "--episode", "3") == 2
    assert "Known: 0 to 0" in capsys.readouterr().err


def test_the_extra_that_lacks_is_named(cameras, tmp_path):
    code = (
        "import sys; sys.modules['viser'] = None\n"
        "import jaxcam.view; jaxcam.view.COMMAND.run(sys.argv[1:])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(cameras), "--save", str(tmp_path / "x.html")],
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 2, done.stderr
    assert "jaxcam[viz]" in done.stderr


def test_pages_are_served_until_ctrl_c(cameras):
    """In a process of its own, which tells where it is."""
    command = [sys.executable, "-u", "-m", "jaxcam.view", str(cameras), "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    guard = threading.Timer(300, process.kill)
    guard.start()
    try:
        line = process.stdout.readline()
        address = next(word for word in line.split() if word.startswith("http://127.0.0.1:"))
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        with opener.open(address) as answer:
            assert MARK in answer.read().decode()
    finally:
        process.send_signal(2)
        _, errors = process.communicate()
        guard.cancel()
    assert process.returncode == 130
    assert "Traceback" not in errors
