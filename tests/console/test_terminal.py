"""What is printed: names and texts from files are shown, and never obeyed."""

import io
import logging

import pytest
from rich.console import Console
from rich.logging import RichHandler
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from jaxcam.console.command import print_error
from jaxcam.console.terminal import terminal
from jaxcam.errors import DatasetError

EVIL = "a\x1b]0;owned\x07\x1b[2J\x9b1m\u202eb"


@pytest.mark.parametrize(
    "show",
    [
        lambda console: console.print(EVIL, markup=False, soft_wrap=True),
        lambda console: console.print(Panel(Text(EVIL), title="x")),
        lambda console: console.print(table()),
        lambda console: RichHandler(console=console).emit(record()),
    ],
)
def test_texts_do_not_steer_the_terminal(show, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    show(terminal())
    shown = capsys.readouterr().out
    for character in ("\x1b", "\x07", "\x9b", "\u202e"):
        assert character not in shown
    assert r"\x1b" in shown
    assert shown.endswith("\n")


def table():
    shown = Table("name")
    shown.add_row(Text(EVIL))
    return shown


def record():
    return logging.LogRecord("a", logging.WARNING, "a.py", 1, "%s", (EVIL,), None)


def test_errors_do_not_steer_the_terminal(capsys):
    print_error(DatasetError(EVIL))
    assert "\x1b" not in capsys.readouterr().err


def test_lines_and_boxes_stay():
    """What rich prints of its own is left as it is."""
    ours, plain = terminal(), Console()
    for console in (ours, plain):
        console.file, console.width = io.StringIO(), 40
        console.print(Panel("two\nlines"), "and [bold]more[/bold]", end="!\n")
    assert ours.file.getvalue() == plain.file.getvalue()  # pyright: ignore
