"""Sizes of pictures as settings have them: one side of a square, or rows and columns."""

import re

from jaxcam.errors import ConfigError

LEAST, MOST = 16, 4096
"""Pixels of a side."""


def rows_and_columns(resolution: int | str, name: str = "resolution") -> tuple[int, int]:
    """Rows and columns of a picture.

    Args:
        resolution: A side of a square, such as 84, or rows and columns, such as "96x128".
        name: What it is the size of, for messages.

    Raises:
        ConfigError: It is neither, or a side is too small or too large.
    """
    match = re.fullmatch(r"([0-9]{1,9})(?:x([0-9]{1,9}))?", str(resolution))
    if not match:
        raise ConfigError(
            f"{name} must be a side, such as 84, or rows and columns, such as 96x128; got "
            f"{str(resolution)[:80]!r}."
        )
    height, width = (int(side) for side in (match[1], match[2] or match[1]))
    for side in (height, width):
        if side < LEAST:
            raise ConfigError(f"{name} must be at least {LEAST}, got {resolution}.")
        if side > MOST:
            raise ConfigError(f"{name} must be at most {MOST}, got {resolution}.")
    return height, width


def size_name(height: int, width: int) -> int | str:
    """The inverse of `rows_and_columns`: an int for a square, else text such as "96x128"."""
    return height if height == width else f"{height}x{width}"
