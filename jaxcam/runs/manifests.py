"""What the checkpoints of a run say of themselves, without a look at their arrays.

A checkpoint's manifest is JSON with a digest of itself; its `side` holds the settings, the data and
the packages that it was trained with.
"""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any


class DamagedError(Exception):
    """Why a checkpoint cannot be used."""


def seal(content: dict[str, Any]) -> dict[str, Any]:
    """The content with a digest of itself."""
    text = json.dumps(content, sort_keys=True)
    return {**content, "sha256": hashlib.sha256(text.encode()).hexdigest()}


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a checkpoint.

    Args:
        folder: Of the checkpoint; its name is the step.

    Raises:
        DamagedError: It is not what was written.
    """
    try:
        manifest = json.loads((folder / "manifest" / "metadata").read_text("utf-8"))
        content = {k: manifest[k] for k in ("step", "side", "leaves")}
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        words = (str(error).splitlines() or [""])[0][:200]
        raise DamagedError(
            f"its manifest cannot be read ({type(error).__name__}: {words})"
        ) from error
    if manifest != seal(content):
        raise DamagedError("its manifest has changed since it was written")
    if str(manifest["step"]) != folder.name:
        raise DamagedError(f"its manifest is of step {manifest['step']}")
    return manifest


def steps_in(directory: Path) -> list[int]:
    """Steps that have a checkpoint in a folder of them, oldest first."""
    if not directory.is_dir():
        return []
    names = [path.name for path in directory.iterdir()]
    # isdigit alone takes other alphabets' digits and superscripts too.
    return sorted(int(name) for name in names if name.isascii() and name.isdigit())


def sides(run: Path) -> dict[int, Mapping[str, Any]]:
    """What a run's whole checkpoints hold beside their arrays, by step."""
    whole: dict[int, Mapping[str, Any]] = {}
    directory = run / "checkpoints"
    for step in steps_in(directory):
        try:
            whole[step] = read_manifest(directory / str(step))["side"]
        except DamagedError:
            continue
    return whole
