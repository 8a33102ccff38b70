"""The terminal that commands print on: what it is given is text, whatever files and paths say.

Rich would take "[/red]" in a path for markup, ":cat:" for a picture, and would let through what
steers a terminal. Here it is the one place that builds a console.
"""

import logging
from dataclasses import dataclass
from typing import Any

from rich.console import Console, ConsoleOptions, ConsoleRenderable, RenderHook, RenderResult
from rich.segment import Segment
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
        self.push_render_hook(_Hook())

    def render_str(self, text: str, **how: Any) -> Text:
        """The text without what would steer the terminal."""
        return super().render_str(printable(text), **how)


@dataclass(frozen=True)
class _Plain:
    """What is printed, with the characters written out that a terminal obeys."""

    content: ConsoleRenderable

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for segment in console.render(self.content, options):
            text = segment.text if segment.control else printable(segment.text)
            yield Segment(text, segment.style, segment.control)


class _Hook(RenderHook):
    def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
        return [_Plain(content) for content in renderables]


class PlainFormatter(logging.Formatter):
    """Messages of the log, without what would steer the terminal."""

    def format(self, record: logging.LogRecord) -> str:
        """The message of a record."""
        return printable(super().format(record))
