"""The terminal that commands print on: what it is given is text, whatever files and paths say.

Rich would take "[/red]" in a path for markup, ":cat:" for a picture, and would let through what
steers a terminal. Here it is the one place that builds a console.
"""

import logging
from typing import Any

from rich.console import Console
from rich.text import Text

from jaxcam.console.words import printable


class Terminal(Console):
    """A console whose texts, those in tables too, are shown as they are.

    Args:
        stderr: Whether to print there instead of on stdout.
        **options: Of rich's console.
    """

    def __init__(self, *, stderr: bool = False, **options: Any) -> None:
        super().__init__(stderr=stderr, markup=False, emoji=False, **options)

    def render_str(self, text: str, **how: Any) -> Text:
        """The text without what would steer the terminal."""
        return super().render_str(printable(text), **how)


class PlainFormatter(logging.Formatter):
    """Messages of the log, without what would steer the terminal."""

    def format(self, record: logging.LogRecord) -> str:
        """The message of a record."""
        return printable(super().format(record))
