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


NOBODY_READS = """
import os, sys
from importlib import import_module
from jaxcam.__main__ import NAMES
for name in NAMES:
    command = import_module(f"jaxcam.{name}").COMMAND
    reader, writer = os.pipe()
    if not (child := os.fork()):
        os.dup2(writer, 1)
        os.close(reader), os.close(writer)
        command.run(["--help"], prog=name)
    os.close(reader), os.close(writer)
    print(name, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


def test_help_whose_reader_has_gone_ends_quietly():
    """As in `jaxcam train --help | head -1`."""
    done = subprocess.run([sys.executable, "-c", NOBODY_READS], capture_output=True, text=True)
    assert done.stderr == ""
    assert done.stdout.splitlines() == [f"{name} 141" for name in table.NAMES]
