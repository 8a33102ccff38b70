"""What a run ran on, as its folder says it."""

import logging
import shutil
import subprocess

import jax
import numpy as np
import pytest

from jaxcam.runs import environment
from jaxcam.runs.environment import git_revision, record_environment


def test_git_revision_only_of_our_own_checkout(tmp_path):
    git = shutil.which("git")
    if git is None:
        pytest.skip("git is not installed")
    subprocess.run([git, "init", "-q", str(tmp_path)], check=True)
    ours = tmp_path / "ours.py"
    ours.write_text("")
    assert git_revision(ours) is None
    who = ["-c", "user.name=x", "-c", "user.email=x@example.org"]
    subprocess.run([git, "-C", str(tmp_path), "add", "ours.py"], check=True)
    subprocess.run([git, "-C", str(tmp_path), *who, "commit", "-qm", "x"], check=True)
    ours.write_text("changed\n")
    revision = git_revision(ours)
    assert revision is not None
    assert len(revision.splitlines()[0]) == 40
    assert "+changed" in revision


def test_packages_system_and_devices_are_written_down(tmp_path, caplog):
    record_environment(tmp_path)
    lines = (tmp_path / "env.txt").read_text().splitlines()
    assert f"numpy {np.__version__}" in lines
    assert f"devices cpu {jax.devices()[0].device_kind}" in "\n".join(lines)
    record_environment(tmp_path)
    assert not caplog.text


def test_another_environment_is_reported(tmp_path, monkeypatch, caplog):
    record_environment(tmp_path)
    monkeypatch.setattr(environment, "environment", lambda: {"numpy": "0.1"})
    with caplog.at_level(logging.WARNING):
        record_environment(tmp_path)
    assert f"numpy {np.__version__} -> 0.1" in caplog.text
    assert f"cpu {jax.devices()[0].device_kind} -> none" in caplog.text
    assert (tmp_path / "env.txt").read_text() == "numpy 0.1\n"


def test_fewer_devices_are_told_with_both_numbers_of_them(tmp_path, monkeypatch, caplog):
    for devices in ("cpu cpu, cpu cpu", "cpu cpu"):
        monkeypatch.setattr(
            environment, "environment", lambda devices=devices: {"devices": devices}
        )
        record_environment(tmp_path)
    assert "not bit-exact: devices cpu cpu, cpu cpu -> cpu cpu." in caplog.text
