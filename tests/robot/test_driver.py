"""Robots of somebody's own: found, made, and what they lack is told."""

import sys
import textwrap

import pytest

from jaxcam.errors import ConfigError
from jaxcam.robot.driver import make_robot

MODULE = """
class Arm:
    rate = 20
    def __init__(self, ip="localhost"): self.ip = ip
    def prepare(self, setup): pass
    def observe(self): return {}
    def act(self, action): pass
    def hold(self): pass
    def stop(self): pass

class Halt(Arm):
    hold = None

class Slow(Arm):
    rate = "20"

class Backwards(Arm):
    speed = -1

class Off(Arm):
    def __init__(self): raise ConnectionRefusedError("nobody is there")
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with a module of robots, which is forgotten afterwards."""
    (tmp_path / "arms_of_a_test.py").write_text(textwrap.dedent(MODULE))
    (tmp_path / "broken_arms_of_a_test.py").write_text("class Arm")
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.delitem(sys.modules, "arms_of_a_test", raising=False)
    return tmp_path


def test_a_robot_lies_beside_the_sheet(folder):
    robot = make_robot("arms_of_a_test:Arm", {"ip": "10.0.0.2"}, folder)
    assert (robot.rate, robot.ip) == (20, "10.0.0.2")


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        ("arms_of_a_test", {}, "is no 'module:Class', and not 'none'"),
        ("arms_of_a_tset:Arm", {}, "'arms_of_a_tset' cannot be imported: No module"),
        ("arms_of_a_test:Leg", {}, "has no class 'Leg'"),
        ("arms_of_a_test:Arm", {"pi": 1}, "does not take these robot_settings: .*'pi'"),
        ("arms_of_a_test:Halt", {}, "lacks hold. docs/robot.md"),
        (".arms_of_a_test:Arm", {}, "is no 'module:Class'"),
        ("sys:Arm", {}, "sys has no class 'Arm'"),
        ("broken_arms_of_a_test:Arm", {}, "cannot be imported: SyntaxError"),
        ("arms_of_a_test:Off", {}, "could not be made: ConnectionRefusedError: nobody is there"),
        ("arms_of_a_test:Backwards", {}, "lacks a speed that is a number from 0 on"),
        ("arms_of_a_test:Slow", {}, "lacks rate, its control steps a second"),
    ],
)
def test_what_is_no_robot_is_refused(folder, name, settings, words):
    with pytest.raises(ConfigError, match=words):
        make_robot(name, settings, folder)
