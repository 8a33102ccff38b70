"""The console of every command: what it prints of names and files cannot steer the terminal."""

from dataclasses import dataclass

from rich.console import Console, ConsoleOptions, ConsoleRenderable, RenderHook, RenderResult
from rich.segment import Segment

from jaxcam.console.words import plain_line


@dataclass(frozen=True)
class _Plain:
    """What is printed, with the characters written out that a terminal obeys."""

    content: ConsoleRenderable

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for segment in console.render(self.content, options):
            lines = segment.text.split("\n")
            text = segment.text if segment.control else "\n".join(map(plain_line, lines))
            yield Segment(text, segment.style, segment.control)


class _Hook(RenderHook):
    def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
        return [_Plain(content) for content in renderables]


def terminal(*, stderr: bool = False) -> Console:
    """A console on which names of files and texts from files are text, whatever is in them.

    Args:
        stderr: Whether it prints where errors go.
    """
    console = Console(stderr=stderr)
    console.push_render_hook(_Hook())
    return console
