"""What is printed is text: no name of a file is markup, a picture, or a command of the terminal."""

import ast
import io
import logging
import os
import pty
import re
import subprocess
import sys

import pytest
from places import REPO
from rich.console import Console
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from jaxcam.console.command import print_error
from jaxcam.console.progress import progress
from jaxcam.console.terminal import PlainFormatter, Terminal
from jaxcam.errors import ConfigError

ODD = "out[/red] [bold]x[/bold] :cat: \x1b[2J\r\udcff"
SHOWN = r"out[/red] [bold]x[/bold] :cat: \x1b[2J\r\udcff"


def test_texts_are_shown_as_they_are():
    terminal = Terminal(file=io.StringIO(), width=200)
    table = Table("name", title=ODD)
    table.add_row(ODD)
    terminal.print(table)
    terminal.print(ODD, soft_wrap=True)
    with progress(terminal, ODD, 1) as advance:
        advance(1, ODD)
    assert terminal.file.getvalue().count(SHOWN) == 5


def test_so_is_what_a_bar_says():
    terminal = Terminal(file=io.StringIO(), width=300, force_terminal=True, color_system=None)
    with progress(terminal, "[/red]", 1) as advance:
        advance(1, "[/blue]")
    shown = terminal.file.getvalue()
    assert "[/red]" in shown
    assert "[/blue]" in shown


def test_so_is_the_log():
    record = logging.LogRecord("a", logging.WARNING, "a.py", 1, "%s: gone", (ODD,), None)
    assert PlainFormatter("%(message)s").format(record) == f"{SHOWN}: gone"


def test_only_the_terminal_builds_a_console_and_nobody_asks_for_markup():
    """So no text, whatever is put into it, is printed with markup on."""
    texts = {path: path.read_text("utf-8") for path in (REPO / "jaxcam").rglob("*.py")}
    prints = re.compile(r"Console\(|print\(|markup|TextColumn")
    for path, text in texts.items():
        for node in ast.walk(ast.parse(text)) if prints.search(text) else ():
            if not isinstance(node, ast.Call):
                continue
            where, called = (path.name, node.lineno), ast.unparse(node.func)
            assert called.split(".")[-1] not in ("Console", "from_markup"), where
            assert called != "print", where
            asked = {k.arg: ast.unparse(k.value) for k in node.keywords}
            has_parts = called == "TextColumn" and "{" in ast.unparse(node.args[0])
            assert asked.get("markup", str(has_parts)) == "False", where


def test_an_error_is_shown_as_it_is(capsys):
    assert print_error(ConfigError(ODD)) == 2
    assert SHOWN in capsys.readouterr().err


EVIL = "a\x1b]0;owned\x07\x1b[2J\x9b1m\u202eb"


@pytest.mark.parametrize("shown", [EVIL, Panel(Text(EVIL), title="x"), Text(EVIL)])
def test_nothing_steers_the_terminal(shown):
    terminal = Terminal(file=io.StringIO(), width=200)
    terminal.print(shown, soft_wrap=True)
    written = terminal.file.getvalue()
    for character in ("\x1b", "\x07", "\x9b", "\u202e"):
        assert character not in written
    assert r"\x1b" in written
    assert written.endswith("\n")


def test_lines_and_boxes_stay():
    """What rich prints of its own is left as it is."""
    written = []
    for kind in (Terminal, Console):
        console = kind(file=io.StringIO(), width=40)
        console.print(Panel("two\nlines"), "and more", end="!\n")
        written.append(console.file.getvalue())
    assert written[0] == written[1]


COLOURED = "from jaxcam.train import COMMAND; COMMAND.run({argv!r})"


@pytest.mark.parametrize("argv", [["--help"], ["--seed", "-1"]])
@pytest.mark.parametrize(
    ("variables", "is_coloured"),
    [({"TERM": "xterm-256color"}, True), ({"TERM": "dumb"}, False), ({"NO_COLOR": "1"}, False)],
)
def test_colours_are_off_where_the_terminal_says_so(argv, variables, is_coloured):
    """In a terminal; without one there are none either."""
    program = [sys.executable, "-c", COLOURED.format(argv=argv)]
    clean = {k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "FORCE_COLOR")}
    main, end = pty.openpty()
    with subprocess.Popen(
        program, stdout=end, stderr=end, env=clean | {"TERM": "xterm-256color"} | variables
    ):
        os.close(end)
        shown = b""
        while part := _some(main):
            shown += part
    os.close(main)
    assert b"seed" in shown
    assert bool(re.search(rb"\x1b\[[0-9;]*3[0-9]", shown)) == is_coloured
    piped = subprocess.run(program, capture_output=True, env=clean | variables)
    assert b"\x1b" not in piped.stdout + piped.stderr


def _some(descriptor):
    """What a terminal shows next; nothing when its program has ended."""
    try:
        return os.read(descriptor, 1 << 16)
    except OSError:
        return b""
