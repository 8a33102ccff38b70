"""What ManiSkill needs of a machine, and what is said where it is missing."""

import subprocess
import sys

import pytest
from running import exit_code

from jaxcam.errors import SimError
from jaxcam.sim.maniskill import machine


def test_the_parent_never_loads_pytorch():
    code = """
import sys
import jaxcam.check, jaxcam.collect, jaxcam.evaluate, jaxcam.replay
from jaxcam.sim import make_task
for name in ("push", "lift_upright", "roll_ball"):
    make_task(name).scene("randomized")
import jaxcam.sim.maniskill.engine, jaxcam.sim.maniskill.render
assert not {"torch", "sapien", "mani_skill", "gymnasium"} & set(sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr


def test_what_is_missing_is_told_before_anything_starts(push, monkeypatch):
    monkeypatch.setattr(machine, "missing_packages", lambda: ["sapien"])
    with pytest.raises(SimError, match=r"sapien cannot be imported.*pip install .*maniskill"):
        push.require()


def test_a_machine_without_vulkan_is_told_how_to_get_it(maniskill, push, monkeypatch):
    monkeypatch.setenv("VK_ICD_FILENAMES", "/nowhere.json")
    machine.device.cache_clear()
    try:
        with pytest.raises(SimError, match=r"(?s)no Vulkan device.*apt-get install.*check --env"):
            push.require()
    finally:
        machine.device.cache_clear()


def test_check_tells_what_there_is_and_how_to_get_the_rest(monkeypatch, capsys):
    monkeypatch.setattr(machine, "missing_packages", lambda: list(machine.PACKAGES.values()))
    exit_code("check", "--env")
    printed = capsys.readouterr().out
    assert "extra maniskill: pip install 'jaxcam[maniskill]'" in printed
    assert "lift, pick_place_can, square" in printed
    assert "without mani-skill, sapien, torch" in printed
