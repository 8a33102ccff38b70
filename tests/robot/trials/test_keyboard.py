"""Lines of the operator, from a terminal and from a program."""

import io
import os
import pty

import pytest
from rich.console import Console

from jaxcam.interrupts import Stopped, interrupts
from jaxcam.robot.trials.keyboard import Keyboard, QuitError

CONSOLE = Console(file=io.StringIO())


def piped(text):
    reader, writer = os.pipe()
    os.write(writer, text)
    os.close(writer)
    return os.fdopen(reader)


def test_lines_of_a_program_are_taken_one_by_one():
    with piped("s\n\nh slipped ä\nq\n".encode()) as stream:
        keyboard = Keyboard(CONSOLE, stream)
        assert [keyboard.ask("?") for _ in range(3)] == ["s", "", "h slipped ä"]
        assert not keyboard.pressed()  # only who types is listened to
        with pytest.raises(QuitError):
            keyboard.ask("?")


@pytest.mark.parametrize("text", [b"", b"s"])
def test_where_nothing_more_comes_it_ends(text):
    with piped(text) as stream:
        keyboard = Keyboard(CONSOLE, stream)
        if text:
            assert keyboard.ask("?") == "s"
        with pytest.raises(QuitError):
            keyboard.ask("?")


def test_without_a_keyboard_it_ends():
    with pytest.raises(QuitError):
        Keyboard(CONSOLE, io.StringIO("s\n")).ask("?")


def test_enter_on_a_terminal_ends_a_rollout_and_answers_nothing():
    ours, theirs = pty.openpty()
    with os.fdopen(theirs) as stream:
        keyboard = Keyboard(CONSOLE, stream)
        assert not keyboard.pressed()
        os.write(ours, b"\n\n")
        assert keyboard.pressed()
        assert not keyboard.pressed()
        os.write(ours, b"s\n")  # typed before the question: it is not for that
        with interrupts() as stop:
            stop.signal = 2
            with pytest.raises(Stopped):
                keyboard.ask("?")
    os.close(ours)
