"""The table of commands."""

import subprocess
import sys

import pytest
from running import exit_code

from jaxcam import __main__ as table


def test_the_table_has_every_command_with_a_line(capsys):
    table.print_commands()
    shown = capsys.readouterr().out
    assert "[" not in shown
    for name in table.NAMES:
        command, line = table.command(name)
        assert line.endswith(".")
        assert line in shown
        assert command.settings.__doc__


@pytest.mark.parametrize("words", [["jaxcam"], ["jaxcam", "--help"]])
def test_jaxcam_alone_shows_the_table(words):
    done = subprocess.run([sys.executable, "-m", *words], capture_output=True, text=True)
    assert done.returncode == 0
    assert "maniskill" in done.stdout


def test_a_command_that_is_not_there_is_told_with_the_closest():
    done = subprocess.run([sys.executable, "-m", "jaxcam", "tarin"], capture_output=True, text=True)
    assert done.returncode == 2
    assert "did you mean 'train'" in done.stderr


@pytest.mark.parametrize("name", table.NAMES)
def test_every_command_has_help(name, capsys):
    assert exit_code(name, "--help") == 0
    assert f"jaxcam {name}" in capsys.readouterr().out
