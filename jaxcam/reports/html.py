"""Parts of our HTML pages. A page loads nothing from the network: pictures are inside it."""

import base64
import datetime
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from string import Template
from typing import Any
from urllib.parse import quote

import jaxcam


def page(title: str, subtitle: str, sections: Iterable[str]) -> str:
    """A whole page.

    Args:
        title: Its heading.
        subtitle: A line below it.
        sections: HTML, from the functions here.
    """
    template = Template(Path(__file__).with_name("template.html").read_text("utf-8"))
    now = datetime.datetime.now().astimezone()
    return template.substitute(
        title=escape(title),
        subtitle=escape(subtitle),
        sections="\n".join(part for part in sections if part),
        version=jaxcam.__version__,
        date=now.strftime("%-d %B %Y, %H:%M %Z"),
    )


def section(title: str, content: str) -> str:
    """A heading and what is below it; nothing without content."""
    return f"<h2>{escape(title)}</h2>\n{content}" if content else ""


def card(content: str) -> str:
    """Content in a frame."""
    return f'<div class="card">{content}</div>'


def folded(title: str, content: str) -> str:
    """Content in a frame that is closed until it is asked for."""
    return f'<details class="card"><summary>{escape(title)}</summary>{content}</details>'


def text(words: str) -> str:
    """A paragraph."""
    return f'<p class="small">{escape(words)}</p>'


def notice(words: str) -> str:
    """What a reader must not overlook."""
    return f'<p class="notice">{escape(words)}</p>'


def table(head: Iterable[str], body: Iterable[Sequence[Any]], rules: Iterable[int] = ()) -> str:
    """A table that scrolls where it is too wide.

    Args:
        head: Names of the columns.
        body: Rows; cells are text, or HTML that `link` made.
        rules: Numbers of the rows that begin a new part.
    """
    rules = set(rules)
    top = "".join(f"<th>{escape(name)}</th>" for name in head)
    lines = "".join(
        f"<tr{' class=rule' if i in rules else ''}>"
        + "".join(f"<td>{_cell(cell)}</td>" for cell in line)
        + "</tr>"
        for i, line in enumerate(body)
    )
    return f'<div class="scroll"><table><tr>{top}</tr>{lines}</table></div>'


class Markup(str):
    """Text that is HTML already."""

    __slots__ = ()


def link(text: str, href: str) -> Markup:
    """A link to a file, relative to the page."""
    return Markup(f'<a href="{quote(href)}">{escape(text)}</a>')


def picture(file: Path, caption: str, *, wide: bool) -> str:
    """A PNG file, put into the page."""
    content = file.read_bytes()
    pixels = int.from_bytes(content[16:20], "big")  # the width stands in a PNG's first chunk
    data = base64.b64encode(content).decode()
    return (
        f"<figure{' class=wide' if wide else ''}>"
        f'<img src="data:image/png;base64,{data}" alt="{escape(caption)}" '
        f'style="max-width:{min(pixels * 3 // 4, 980)}px">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def pictures(figures: Iterable[str]) -> str:
    """Pictures beside one another."""
    inside = "".join(figures)
    return f'<div class="figures">{inside}</div>' if inside else ""


def video(href: str, caption: str) -> str:
    """A player for a file that stays beside the page."""
    return (
        f'<video src="{quote(href)}" controls loop muted playsinline preload="metadata"></video>'
        f'<p class="small">{escape(caption)}</p>'
    )


def _cell(cell: Any) -> str:
    return cell if isinstance(cell, Markup) else escape(str(cell))
