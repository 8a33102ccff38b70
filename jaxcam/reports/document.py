"""A report's content once, written as Markdown, LaTeX and HTML."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from jaxcam.reports.html import embedded, render
from jaxcam.reports.names import address, latex, markdown, markdown_cell


@dataclass(frozen=True)
class Heading:
    """Begins a part."""

    text: str


@dataclass(frozen=True)
class Text:
    """A paragraph.

    Attributes:
        text: What it says.
        warns: Whether a reader must not overlook it.
    """

    text: str
    warns: bool = False


@dataclass(frozen=True)
class Link:
    """A link to a file, relative to the report."""

    text: str
    href: str


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes:
        caption: What it shows.
        head: Names of its columns.
        rows: Its cells, texts (of one or more lines) or `Link`s.
        rules: Numbers of the rows that begin a new part.
        folded: Whether it is long: HTML closes it, LaTeX leaves it out.
    """

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str | Link]]
    rules: Sequence[int] = ()
    folded: bool = False


@dataclass(frozen=True)
class Picture:
    """A PNG file.

    Attributes:
        path: Relative to the report.
        caption: What it shows.
    """

    path: str
    caption: str


Block = Heading | Text | Table | Picture


@dataclass(frozen=True)
class Document:
    """A title, a line below it, and blocks in order."""

    title: str
    subtitle: str
    blocks: Sequence[Block]


def to_markdown(document: Document) -> str:
    """The document as Markdown, as GitHub reads it."""
    parts = [f"# {document.title}", document.subtitle]
    for block in document.blocks:
        match block:
            case Heading():
                parts.append(f"## {markdown(block.text)}")
            case Text():
                text = markdown(block.text)
                parts.append(f"**{text}**" if block.warns else text)
            case Picture():
                shown = f"![{Path(block.path).stem}]({address(block.path)})"
                parts.append(f"{shown}\n\n{markdown(block.caption)}")
            case Table():
                lines = [block.head, ["---"] * len(block.head), *block.rows]
                body = "\n".join(f"| {' | '.join(map(_markdown, line))} |" for line in lines)
                parts.append(f"{markdown(block.caption)}\n\n{body}")
    return "\n\n".join(parts) + "\n"


def to_latex(document: Document) -> str:
    """The document as LaTeX to be read in with `input`; needs booktabs and graphicx."""
    parts = [f"% {document.title}. {document.subtitle}\n% \\usepackage{{booktabs, graphicx}}"]
    for block in document.blocks:
        match block:
            case Heading():
                parts.append(f"\\section{{{_latex(block.text)}}}")
            case Text():
                text = _latex(block.text)
                parts.append(f"\\textbf{{{text}}}" if block.warns else text)
            case Picture():
                parts.append(
                    "\\begin{figure}[htbp]\n  \\centering\n"
                    f"  \\includegraphics[width=\\linewidth]{{{block.path}}}\n"
                    f"  \\caption{{{_latex(block.caption)}}}\n\\end{{figure}}"
                )
            case Table() if not block.folded:
                parts.append(_latex_table(block))
    return "\n\n".join(parts) + "\n"


def to_html(document: Document, folder: Path) -> str:
    """The document as one page with its pictures inside.

    Args:
        document: What it says.
        folder: That the pictures' paths are relative to.
    """
    blocks: list[tuple[str, object]] = []
    for pictures, group in itertools.groupby(document.blocks, lambda b: isinstance(b, Picture)):
        if pictures:
            shown = (block for block in group if isinstance(block, Picture))
            figures = [embedded(folder / p.path, p.caption, wide=True) for p in shown]
            blocks.append(("Pictures", figures))
        else:
            blocks += [(type(block).__name__, block) for block in group]
    return render("document.html", document.title, document.subtitle, blocks=blocks)


def _latex_table(table: Table) -> str:
    lines = []
    for i, row in enumerate(table.rows):
        if i in table.rules and i:
            lines.append("    \\midrule")
        lines.append(f"    {' & '.join(map(_latex, row))} \\\\")
    head = " & ".join(f"\\textbf{{{_latex(name)}}}" for name in table.head)
    body = "\n".join(["    \\toprule", f"    {head} \\\\", "    \\midrule", *lines,
                      "    \\bottomrule"])  # fmt: skip
    return (
        f"\\begin{{table*}}[htbp]\n  \\centering\n  \\caption{{{_latex(table.caption)}}}\n"
        "  \\resizebox{\\linewidth}{!}{%\n"
        f"  \\begin{{tabular}}{{{'l' * len(table.head)}}}\n{body}\n  \\end{{tabular}}}}\n"
        "\\end{table*}"
    )


def _markdown(cell: str | Link) -> str:
    if isinstance(cell, Link):
        return f"[{markdown_cell(cell.text)}]({address(cell.href)})"
    return markdown_cell(cell)


def _latex(cell: str | Link) -> str:
    return latex(cell.text if isinstance(cell, Link) else cell)
