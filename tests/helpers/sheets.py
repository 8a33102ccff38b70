"""Sheets of trials, and what happens around a small one."""

import copy
from pathlib import Path

import yaml

SHEET = {
    "task": "Pick Place",
    "success": "The cup is in the bowl.",
    "half": "The cup was lifted and slipped.",
    "policies": [
        {"name": "ACT with poses", "url": "ws://127.0.0.1:1"},
        {"name": "ACT without", "url": "ws://127.0.0.1:2"},
    ],
    "cameras": {
        "names": ["left", "right", "top"],
        "use": 2,
        "file": "cameras.json",
        "placements": [1, 2, 3, 4, 5, 6, 7],
    },
    "starts": ["Cup on 1.", "Cup on 2.", "Cup on 3.", "Cup on 4."],
}
"""Of the paper's size: seven placements, two of three cameras."""


def write_sheet(folder, **changes):
    """A file of a sheet; a change that is None takes the entry away."""
    content = copy.deepcopy(SHEET) | changes
    content = {name: value for name, value in content.items() if value is not None}
    path = Path(folder) / "sheet.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return path
