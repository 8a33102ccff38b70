"""Our HTML pages, from the templates beside this file; all text in them is escaped.

A page loads nothing from the network: pictures are inside it.
"""

import base64
import datetime
import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2

import jaxcam
from jaxcam.files.paths import read_bytes
from jaxcam.reports.names import address

_WIDEST = 980
"""Pixels of a browser that a picture takes at most."""


@dataclass(frozen=True)
class Embedded:
    """A picture inside a page.

    Attributes:
        data: Its PNG file in base64.
        caption: What it shows.
        pixels: How wide it is shown at most.
        wide: Whether it has a line of its own.
    """

    data: str
    caption: str
    pixels: int
    wide: bool


def own_files(folder: Path, pattern: str) -> list[Path]:
    """Files of a folder in order, without links: those show what lies elsewhere.

    Args:
        folder: Where.
        pattern: Of their names.
    """
    if folder.is_symlink():
        return []
    return sorted(f for f in folder.glob(pattern) if f.is_file() and not f.is_symlink())


def embedded(file: Path, caption: str, *, wide: bool) -> Embedded:
    """A PNG file, to be put into a page.

    Args:
        file: The file.
        caption: What it shows.
        wide: Whether it has a line of its own.
    """
    content = read_bytes(file)
    pixels = int.from_bytes(content[16:20], "big")  # the width stands in a PNG's first chunk
    data = base64.b64encode(content).decode()
    return Embedded(data, caption, min(pixels * 3 // 4, _WIDEST), wide)


def render(template: str, title: str, subtitle: str, **content: Any) -> str:
    """A whole page.

    Args:
        template: Name of a file in `templates`.
        title: The page's heading.
        subtitle: A line below it.
        **content: What the template asks for.
    """
    date = datetime.datetime.now().astimezone().strftime("%-d %B %Y, %H:%M %Z")
    return (
        _templates()
        .get_template(template)
        .render(title=title, subtitle=subtitle, version=jaxcam.__version__, date=date, **content)
    )


@functools.cache
def _templates() -> jinja2.Environment:
    templates = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).with_name("templates")),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.filters["address"] = address
    return templates
