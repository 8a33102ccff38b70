"""Texts that come from files, as each kind of reader wants them: nothing in them is a command.

Tasks, runs and settings have any name in rows that somebody else wrote. Here they become file
names, TeX, CSV, Markdown and addresses. HTML is escaped by the templates, and what goes to a
terminal by `jaxcam.console.terminal`.
"""

import hashlib
import re
from urllib.parse import quote

from jaxcam.console.words import plain_line

_LONGEST = 100
_WIDE_WORD = r"(\S{47})\S{2,}"  # a figure has no room for more
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
_TEX = {"\\": r"\textbackslash{}", "–": "--", "×": r"$\times$", "≥": r"$\geq$", "<": "$<$",
        ">": "$>$", "−": "$-$", "’": "'", "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}"} | {c: f"\\{c}" for c in "&%$#_{}"}  # fmt: skip
_TEX["["] = "{[}"  # after a line's end it would begin an option


def file_name(text: str) -> str:
    """The text as the name of a file, without an ending; one that had to change has a digest.

    Args:
        text: Any text.
    """
    safe = re.sub(r"[^A-Za-z0-9_.+-]+", "_", text).lstrip(".-")[:_LONGEST]
    if safe == text:
        return safe
    return f"{safe}-{hashlib.sha256(text.encode(errors='replace')).hexdigest()[:8]}"


def drawn(text: str) -> str:
    """The text as matplotlib draws it, without formulas (between dollars) and endless words.

    Args:
        text: Any text.
    """
    lines = (re.sub(_WIDE_WORD, "\\1…", plain_line(line)) for line in text.split("\n"))
    return "\n".join(lines).replace("$", r"\$")


def latex(text: str) -> str:
    """The text as LaTeX; several lines become a stack.

    Args:
        text: Any text.
    """
    lines = ["".join(_TEX.get(c, c) for c in plain_line(line)) for line in text.split("\n")]
    return lines[0] if len(lines) == 1 else r"\shortstack[l]{" + r" \\ ".join(lines) + "}"


def markdown_cell(text: str) -> str:
    """The text as a cell of a Markdown table.

    Args:
        text: Any text.
    """
    lines = (re.sub(r"([|*_])", r"\\\1", markdown(line)) for line in text.split("\n"))
    return "<br>".join(lines)


def markdown(text: str) -> str:
    """The text as a line of Markdown, without tags, links, pictures, code or entities of its own.

    Args:
        text: Any text.
    """
    text = re.sub(r"([\\`])", r"\\\1", plain_line(text))
    text = re.sub(r"&(?=[#\w])", "&amp;", text).replace("<", "&lt;")
    return re.sub(r"\]([(\[:])", r"\\]\1", text)


def csv_cell(text: str) -> str:
    """The text as a cell of CSV, which no table program takes for a formula.

    Args:
        text: Any text.
    """
    try:
        float(text)
    except ValueError:
        return f"'{text}" if text.startswith(_FORMULA) else text
    return text


def address(path: str) -> str:
    """A relative path as a page links to it.

    Args:
        path: With slashes.
    """
    named = path if path.startswith((".", "/")) else f"./{path}" if ":" in path else path
    return quote(named, errors="surrogateescape")  # names of files may be no text
