"""Findings: what a check says of one thing, and how a person sees that in a terminal."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from rich.console import Console
from rich.table import Table
from rich.text import Text

Mark = Literal["good", "note", "bad"]
"""Whether all is well, something should be known, or something must be mended."""
COLOURS: dict[Mark, str] = {"good": "green", "note": "yellow", "bad": "red"}
"""Of each mark in a terminal."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What a check has to say of one thing; `good`, `note` and `bad` make them."""

    what: str
    """The thing."""
    mark: Mark
    got: str
    """How it is."""
    expected: str = ""
    """How it should be."""
    where: str = ""
    """Which of several."""
    fix: str = ""
    """How to mend it, or to get what is missing."""

    def __post_init__(self) -> None:
        """Writes halves of characters as what stands for them: they cannot be shown or stored."""
        for name in ("got", "expected", "where", "fix"):
            text = getattr(self, name).encode("utf-8", "backslashreplace").decode("utf-8")
            object.__setattr__(self, name, text)


def good(what: str, *, got: str, where: str = "") -> Finding:
    """A finding that nothing is wrong."""
    return Finding(what=what, mark="good", got=got, where=where)


def note(what: str, *, got: str, expected: str = "", where: str = "", fix: str = "") -> Finding:
    """A finding that one should know of; the run or the dataset can be used."""
    return Finding(what=what, mark="note", got=got, expected=expected, where=where, fix=fix)


def bad(what: str, *, got: str, expected: str = "", where: str = "", fix: str = "") -> Finding:
    """A finding that must be mended."""
    return Finding(what=what, mark="bad", got=got, expected=expected, where=where, fix=fix)


def worst(findings: Iterable[Finding]) -> Mark:
    """The mark of all together."""
    marks = {finding.mark for finding in findings}
    return "bad" if "bad" in marks else "note" if "note" in marks else "good"


def show(findings: Sequence[Finding], console: Console) -> None:
    """Prints findings as a table, and below it how to mend what is not good."""
    table = Table("what", "", "found")
    for finding in findings:
        mark = Text(finding.mark, COLOURS[finding.mark])
        got = finding.got
        if finding.expected and finding.mark != "good":
            got += f"\nexpected: {finding.expected}"
        table.add_row(named(finding), mark, got)
    console.print(table)
    fixes: dict[str, list[str]] = {}
    for finding in findings:
        fixes.setdefault(finding.fix, []).append(finding.what)
    for fix, names in fixes.items():
        if fix:
            console.print(f"{', '.join(dict.fromkeys(names))}: {fix}", soft_wrap=True)


def named(finding: Finding) -> str:
    """The thing that a finding is about, and the place."""
    return f"{finding.what}, {finding.where}" if finding.where else finding.what
