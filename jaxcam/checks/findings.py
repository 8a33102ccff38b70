"""What a check finds, one thing at a time, and how a person sees it in a terminal."""

from collections.abc import Iterable, Sequence
from typing import Literal, NamedTuple

from rich.console import Console
from rich.table import Table
from rich.text import Text

Mark = Literal["good", "note", "bad"]
"""Whether all is well, something should be known, or something must be mended."""
COLOURS: dict[Mark, str] = {"good": "green", "note": "yellow", "bad": "red"}
"""Of each mark in a terminal."""


class Finding(NamedTuple):
    """What was found of one thing."""

    what: str
    """The thing."""
    mark: Mark
    got: str
    """What was found."""
    expected: str = ""
    """What should have been."""
    where: str = ""
    """Which of several."""
    fix: str = ""
    """How to mend it, or to get what is missing."""


def worst(findings: Iterable[Finding]) -> Mark:
    """The mark of all together."""
    marks = {finding.mark for finding in findings}
    return "bad" if "bad" in marks else "note" if "note" in marks else "good"


def some(names: Sequence[object], most: int = 5) -> str:
    """The first names of a list, and how many more there are."""
    rest = len(names) - most
    return ", ".join(map(str, names[:most])) + (f" and {rest} more" if rest > 0 else "")


def show(findings: Sequence[Finding], console: Console) -> None:
    """Prints findings as a table, and below it how to mend what is not good."""
    table = Table("what", "", "found")
    for finding in findings:
        mark = Text(finding.mark, COLOURS[finding.mark])
        found = finding.got
        if finding.expected and finding.mark != "good":
            found += f"\nexpected: {finding.expected}"
        table.add_row(Text(named(finding)), mark, Text(found))
    console.print(table)
    fixes: dict[str, list[str]] = {}
    for finding in findings:
        fixes.setdefault(finding.fix, []).append(finding.what)
    for fix, names in fixes.items():
        if fix:
            console.print(Text(f"{', '.join(dict.fromkeys(names))}: {fix}"), soft_wrap=True)


def named(finding: Finding) -> str:
    """What a finding is about, and where."""
    return f"{finding.what}, {finding.where}" if finding.where else finding.what
