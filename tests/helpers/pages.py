"""The pages of the documentation, and the blocks of code in them."""

import re
from dataclasses import dataclass
from pathlib import Path

from places import REPO

PAGES = [
    REPO / "README.md",
    REPO / "CONTRIBUTING.md",
    *sorted((REPO / "docs").rglob("*.md")),
    *sorted((REPO / "examples").rglob("*.md")),
]
FENCE = re.compile(r"^( *)```(.*)\n((?:.*\n)*?)\1```$", re.MULTILINE)
REASON = re.compile(r"<!-- not run: (.+) -->\s*\Z")


@dataclass(frozen=True)
class Block:
    """A block of code.

    Attributes:
        page: The page that has it.
        line: Of its first line.
        language: What the page says that it is.
        text: The code.
        reason: Why it is not run; empty if it is.
    """

    page: Path
    line: int
    language: str
    text: str
    reason: str

    def __str__(self):
        return f"{self.page.relative_to(REPO)}:{self.line}"


def blocks_of(page):
    """The blocks of a page, in order."""
    text = page.read_text(encoding="utf-8")
    for match in FENCE.finditer(text):
        before = text[: match.start()]
        reason = REASON.search(before)
        yield Block(
            page=page,
            line=before.count("\n") + 2,
            language=match[2],
            text=re.sub(f"^{match[1]}", "", match[3], flags=re.MULTILINE),
            reason=reason[1] if reason else "",
        )
