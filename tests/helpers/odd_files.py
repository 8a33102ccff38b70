"""Damage to files: bits flipped in 60 places, and 60 values that do not belong where they are."""

import json
import random

COUNT = 60
ODD = [
    None, True, False, -1, 0, 1, 2, 1.5, -0.0, 2**31, 2**63, 10**400, float("inf"), float("nan"),
    "", "\0", "\ud800", "x" * 5000, "../../../x", "[/red]", "NaN", [], [[]], [None], [1, "a"], {},
    {"": {}}, {"a": 1}, [{}], "\x1b[2J",
]  # fmt: skip
"""Values of all kinds that JSON has."""
TEXTS = ["", "null", "[]", "7", '"a"', "{", "[" * 200_000, "{}", '{"a": 1}', "\ufeff{}", "NaN"]
"""Whole files."""


def written(objects):
    return "".join(json.dumps(content) + "\n" for content in objects)


def places(value, path=()):
    """Where a value has parts."""
    yield path
    parts = value.items() if isinstance(value, dict) else ()
    parts = enumerate(value) if isinstance(value, list) else parts
    for key, part in parts:
        yield from places(part, (*path, key))


def replaced(value, path, odd):
    """A copy of a value with something else at a place."""
    if not path:
        return odd
    copy = dict(value) if isinstance(value, dict) else list(value)
    copy[path[0]] = replaced(value[path[0]], path[1:], odd)
    return copy


def odd_texts(objects):
    """A file's text with odd values at places that are drawn, and other texts instead of it."""
    drawn = random.Random(0)
    all_places = [place for place in places(objects) if place]
    for _ in range(COUNT):
        yield written(replaced(objects, drawn.choice(all_places), drawn.choice(ODD)))
    yield from TEXTS


def flipped(content):
    drawn = random.Random(1)
    for _ in range(COUNT):
        damaged = bytearray(content)
        damaged[drawn.randrange(len(content))] ^= 1 << drawn.randrange(8)
        yield bytes(damaged)
