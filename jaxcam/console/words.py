"""Words of messages that several packages have in common."""

from collections.abc import Sequence


def plain_line(text: str) -> str:
    """The text as one line of a terminal: what would steer it is written out.

    Args:
        text: Any text.
    """
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def printable(text: str) -> str:
    """The text with the lines that it has, each as `plain_line` has it."""
    return "\n".join(map(plain_line, text.split("\n")))


def some(names: Sequence[object], most: int = 5) -> str:
    """The first `most` names of a list, and how many more there are."""
    rest = len(names) - most
    return ", ".join(map(str, names[:most])) + (f" and {rest} more" if rest > 0 else "")
