"""The operator's keyboard: lines, waited for in a way that Ctrl-C ends."""

import os
import select
import sys
from typing import TextIO

from rich.console import Console

from jaxcam.interrupts import check_stop

_STEP = 0.2
"""Seconds after which Ctrl-C is heeded."""


class QuitError(Exception):
    """The operator stops here."""


class Keyboard:
    """Lines that somebody types, or that a program writes for them.

    Args:
        console: Where questions are printed.
        stream: What is read; the process's stdin when None.
    """

    def __init__(self, console: Console, stream: TextIO | None = None) -> None:
        self._console = console
        self._typed, self._ended = b"", False
        try:
            self._file = (stream or sys.stdin).fileno()
        except (AttributeError, OSError, ValueError):  # closed, or none at all
            self._file, self._ended = -1, True
        self._is_typed = not self._ended and os.isatty(self._file)

    def ask(self, question: str) -> str:
        """The line that answers a question; what was typed before it counts not.

        Args:
            question: What to print before it.

        Raises:
            QuitError: The answer is `q`, or nothing more will come.
            Stopped: Ctrl-C.
        """
        self.pressed()
        self._console.print(question, highlight=False, soft_wrap=True)
        while b"\n" not in self._typed and not self._ended:
            check_stop()
            self._read(_STEP)
        line, newline, self._typed = self._typed.partition(b"\n")
        answer = line.decode(errors="replace").strip()
        if answer.lower() in ("q", "quit") or not (newline or answer):
            raise QuitError
        return answer

    def pressed(self) -> bool:
        """Whether Enter was pressed since the last line; only who types is listened to."""
        check_stop()
        if not self._is_typed:
            return False
        while self._read(0):
            pass
        was_pressed, self._typed = b"\n" in self._typed, b""
        return was_pressed

    def _read(self, seconds: float) -> bool:
        """Whether something came."""
        if self._ended or not select.select([self._file], [], [], seconds)[0]:
            return False
        new = os.read(self._file, 4096)
        self._typed += new
        self._ended = not new
        return bool(new)
