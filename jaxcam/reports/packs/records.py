"""`runs.json` of a results folder: what is kept of each run beside its rows."""

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast, get_args, get_origin

from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.files.paths import read_text
from jaxcam.results.protocol import NOT_RECORDED
from jaxcam.results.rows import USUAL_WAY
from jaxcam.runs.identity import Settings, changes, said

NAMED = ("task", "scene", "policy", "conditioning")
"""Settings that every run has."""


def _kinds(annotation: Any) -> set[type]:
    """The plain types in an annotation; a `Literal` of names is text."""
    if get_origin(annotation) is Literal:
        return {type(value) for value in get_args(annotation)}
    if isinstance(annotation, type) and not get_args(annotation):
        return {annotation}
    return {kind for part in get_args(annotation) for kind in _kinds(part)}


_KNOWN = {field.name: _kinds(field.type) for field in dataclasses.fields(TrainConfig)}
_SEVERAL = {f.name for f in dataclasses.fields(TrainConfig) if isinstance(f.default, tuple)}


@dataclass(frozen=True)
class RunRecord:
    """What is kept of a run.

    Attributes:
        run: Its number, which its rows have.
        name: Its folder's name.
        seed: Its seed; None where that is not known.
        settings: What makes it comparable to others.
        seconds: Wall time of its training.
    """

    run: int
    name: str
    seed: int | None
    settings: Settings
    seconds: float


def read_records(file: Path) -> list[RunRecord]:
    """The runs of a results folder.

    Args:
        file: Its `runs.json`.

    Raises:
        DatasetError: It is not what `write_results` writes.
    """
    try:
        content = json.loads(read_text(file))
    except (OSError, ValueError, RecursionError) as error:
        raise DatasetError(f"{file} cannot be read: {error}.") from error
    if not isinstance(content, list):
        raise DatasetError(f"{file}: expected a list of runs, got {type(content).__name__}.")
    entries = cast("list[Any]", content)
    records = [_record(f"{file}, run {i}", entry) for i, entry in enumerate(entries)]
    if len({record.run for record in records}) < len(records):
        raise DatasetError(f"{file}: two runs have one number.")
    return records


def _record(where: str, entry: Any) -> RunRecord:
    if not isinstance(entry, Mapping):
        raise DatasetError(f"{where}: expected its number, name, seed, settings and seconds.")
    given = cast("Mapping[str, Any]", entry)
    seconds = given.get("seconds", 0)
    checks = (
        ("run", _is_count(given.get("run")), "a whole number"),
        ("name", isinstance(given.get("name"), str), "text"),
        ("seed", given.get("seed") is None or _is_count(given["seed"]), "a whole number or null"),
        ("settings", isinstance(given.get("settings"), Mapping), "names and values"),
        ("seconds", _is_number(seconds) and 0 <= seconds < 1e12, "a number"),
    )
    for name, fits, expected in checks:
        if not fits:
            raise DatasetError(f"{where}: {name} is {given.get(name)!r}, expected {expected}.")
    settings = dict(cast("Mapping[str, Any]", given["settings"]))
    if settings.get("preset") is not None:  # what was not trained here lacks nothing
        settings = TrainConfig.completed(settings)
    settings = said(settings)
    settings |= {name: NOT_RECORDED for name in NAMED if name not in settings}
    for name, value in settings.items():
        if not _fits(name, value):
            raise DatasetError(f"{where}: the setting {name} is {value!r}, which it cannot be.")
        if name in NAMED and not isinstance(value, str):
            raise DatasetError(f"{where}: {name} is {value!r}, expected a name.")
    try:
        if settings.get("preset") is not None:
            changes(settings)
    except (ConfigError, KeyError, TypeError, ValueError) as error:
        raise DatasetError(
            f"{where}: the settings are not those of a run of this version ({error})."
        ) from error
    return RunRecord(given["run"], given["name"], given.get("seed"), settings, float(seconds))


def _fits(name: str, value: Any) -> bool:
    """Whether a setting can have the value: what it is is text, how much is a number."""
    if isinstance(value, list):
        several = cast("list[Any]", value)
        # A run that was evaluated in several ways has a list of them.
        if name not in _SEVERAL | set(USUAL_WAY):
            return False
        return all(isinstance(v, str | int | float) and _fits(name, v) for v in several)
    kinds = _KNOWN.get(name, {str, int, float})
    if value is None or isinstance(value, bool):
        return True
    if isinstance(value, str):
        return str in kinds
    return _is_number(value) and bool(kinds & {int, float})


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**63


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
