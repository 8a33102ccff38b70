"""Places that cannot be read or written: every command ends with a sentence and an exit code.

The commands run in this process. Each runs with all rights first, so that what it imports is
loaded when its rights are gone: a clone may be readable by its owner alone.
"""

import json
import os
import shutil
import subprocess
import sys

import pytest
from places import REPO
from running import exit_code
from small_grid import SMALL

from jaxcam.__main__ import NAMES

ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give its rights up for a test")
NOWHERE = 65534
VIEW = {
    "K": {"fx": 60, "fy": 60, "cx": 32, "cy": 24}, "size": [64, 48],
    "base_from_camera": {"position": [1, 0, 0.5], "quaternion_wxyz": [1, 0, 0, 0]},
}  # fmt: skip


@pytest.fixture
def bad(tmp_path):
    """Places of each bad kind, and a folder of the test's own."""
    (tmp_path / "file").write_text("mine")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    return [
        tmp_path / "file" / "x",
        tmp_path / "file" / "x" / "y.hdf5",
        tmp_path / "loop" / "x",
        tmp_path / ("n" * 300),
        tmp_path / ("🦾" * 80) / "x.html",
        "/proc/nowhere/x",
        "/dev/null/x",
    ]


@pytest.fixture
def commands(demos, tmp_path):
    """Words of every command, in which PLACE is a place that is read or written."""
    grid = tmp_path / "grid.yaml"
    grid.write_text(SMALL.format(folder=tmp_path).replace(f"{tmp_path}/runs", "PLACE"))
    cameras = tmp_path / "cameras.json"
    cameras.write_text(json.dumps({"format": 1, "views": {"front": VIEW}}))
    data, results = str(demos.path), str(REPO / "results" / "lift")
    few = ["--demos", "1", "--validation", "1"]
    train = ["train", "--dataset", data, "--steps", "2"]
    return [
        [*train, "--run-dir", "PLACE"],
        [*train, "--run-dir", str(tmp_path / "run"), "--weights", "PLACE"],
        ["train", "--steps", "2", "--run-dir", str(tmp_path / "run"), "--dataset", "PLACE"],
        ["evaluate", "PLACE"],
        ["serve", "PLACE", "--port", "0"],
        ["trial", "PLACE"],
        ["collect", *few, "--data-dir", "PLACE"],
        ["replay", "PLACE"],
        ["report", "PLACE", "--out", str(tmp_path / "out")],
        ["report", results, "--out", "PLACE"],
        ["sweep", "PLACE"],
        ["check", "PLACE"],
        ["view", str(cameras), "--save", "PLACE"],
        ["view", "PLACE"],
        ["check", "PLACE", "--out", "PLACE"],
        ["calibrate", "lens", "PLACE", "--view", "front"],
        ["calibrate", "lens", "--print-board", "PLACE"],
        ["calibrate", "tags", "PLACE", "--view", "front"],
        ["calibrate", "hand-eye", "PLACE", "--view", "front"],
        ["calibrate", "arm", "PLACE", "--view", "front"],
        ["calibrate", "arm", "PLACE", "--view", "front", "--robot", "PLACE"],
        ["calibrate", "drift", "PLACE"],
        ["weights", "PLACE"],
        ["weights", "PLACE", "--export", "PLACE"],
        ["weights", "PLACE", "--run-dir", "PLACE"],
        ["robomimic", "PLACE", "--out", "PLACE"],
        ["maniskill", "PLACE", "--out", "PLACE"],
        ["lerobot", "PLACE", "PLACE"],
        ["lerobot", data, "PLACE"],
    ]


def ends(capsys, words, place):
    """Runs a command at a place: it fails with a message of ours."""
    words = [str(place) if word == "PLACE" else word for word in words]
    code = exit_code(*words)
    shown = capsys.readouterr()
    assert code in (1, 2, 3, 4, 5, 7), (words, code, shown)
    assert "Traceback" not in shown.out + shown.err
    assert shown.err or shown.out


def test_every_command_is_there(commands):
    assert {words[0] for words in commands} == {*NAMES}


def test_places_that_cannot_be(commands, bad, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for words in commands:
        for place in bad:
            ends(capsys, words, place)
    assert (tmp_path / "file").read_text() == "mine"


@ROOT
def test_no_rights(commands, capsys, monkeypatch, tmp_path):
    tmp_path.chmod(0o755)
    monkeypatch.chdir(tmp_path)
    shutil.copy(tmp_path / "grid.yaml", tmp_path / "file")
    (tmp_path / "locked").mkdir()
    (tmp_path / "locked" / "config.json").write_text("{}")
    places = [tmp_path / "file", tmp_path / "locked", tmp_path / "locked" / "x" / "y.hdf5"]
    (tmp_path / "locked").chmod(0)
    (tmp_path / "file").chmod(0)
    for words in commands:
        ends(capsys, words, tmp_path / "file" / "x")
    os.seteuid(NOWHERE)
    try:
        for words in commands:
            for place in places:
                ends(capsys, words, place)
    finally:
        os.seteuid(0)


WALK = """
import contextlib, io, json, sys
from importlib import import_module
codes = {}
for name, *words in json.loads(sys.argv[1]):
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            import_module(f"jaxcam.{name}").COMMAND.run(words, prog=name)
    except SystemExit as ended:
        codes[name] = [ended.code or 0, said.getvalue()]
print(json.dumps(codes))
"""


def test_no_device_no_home_and_no_caches(commands, tmp_path):
    """JAX has no such platform, and nothing can be written where caches and homes would be."""
    nowhere = dict.fromkeys(("HOME", "WARP_CACHE_PATH", "XDG_CACHE_HOME"), "/proc/nowhere")
    asked = {words[0]: words for words in commands}
    asked["check"], asked["report"] = ["check", "--env"], ["report", "none"]
    asked["collect"] = ["collect", "--data-dir", "/proc/nowhere"]
    words = [[str(tmp_path / "x") if w == "PLACE" else w for w in some] for some in asked.values()]
    done = subprocess.run(
        [sys.executable, "-c", WALK, json.dumps(words)], capture_output=True, text=True,
        cwd=tmp_path, env={**os.environ, **nowhere, "JAX_PLATFORMS": "nonsense"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    codes = json.loads(done.stdout.splitlines()[-1])
    assert codes.keys() == {*NAMES}
    for name, (code, said) in codes.items():
        assert code in (1, 2, 3, 4, 5, 7), (name, code, said)
        assert "Traceback" not in said
    assert "nonsense" in codes["train"][1]
