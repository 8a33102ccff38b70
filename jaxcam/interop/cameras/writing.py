"""Files of calibrations, written and updated: what is in one already stays."""

import datetime
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from jaxcam.errors import ConfigError, JaxcamError
from jaxcam.files.json import read_json
from jaxcam.files.locks import exclusive
from jaxcam.files.whole import whole
from jaxcam.interop.cameras.files import FORMAT, IMAGES, POSES, read_cameras
from jaxcam.interop.cameras.grips import GripEntries
from jaxcam.rays.rotations import quaternion_from_matrix

PLACED = (*POSES, "grip", "axes")
"""Entries of a view's pose: a new one takes the place of all of them."""
OPTICS = ("K", "size", "pixel_centers", "lens", "distortion")
"""Likewise of how it sees."""

ViewJson = dict[str, Any]


@dataclass(frozen=True)
class Changes:
    """What a calibration changes in a file."""

    views: Mapping[str, ViewJson] = field(default_factory=dict)
    """By the view's name, entries of `docs/cameras.schema.json`."""
    episodes: Mapping[str, Mapping[str, ViewJson]] = field(default_factory=dict)
    """By an episode's number, then by the view's name."""
    everywhere: tuple[str, ...] = ()
    """Views whose new pose was measured in all episodes: poses that single ones had go."""
    about: Mapping[str, Any] = field(default_factory=dict)
    """By the view's name, how well it was calibrated; goes into `about`, `calibration`."""
    called: Mapping[str, str] = field(default_factory=dict)
    """Names of episodes by their numbers, which the file may have instead."""


def optics_json(
    K: np.ndarray, size: tuple[int, int], lens: str, distortion: np.ndarray
) -> ViewJson:
    """The entries that say how a view sees.

    Args:
        K: Array [3, 3], its pixels ours.
        size: Width and height that it is for.
        lens: `opencv` or `fisheye`.
        distortion: Coefficients in OpenCV's order.
    """
    names = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
    return {
        "K": {name: round(float(value), 4) for name, value in names.items()},
        "size": [*size],
        "pixel_centers": 0.5,
        "lens": lens,
        "distortion": [float(f"{value:.8g}") for value in distortion],
    }


def pose_json(base_from_camera: np.ndarray) -> ViewJson:
    """The entry that says where a view stood, [4, 4]."""
    return {"base_from_camera": _parts(base_from_camera)}


def carried_json(grip_from_camera: np.ndarray, grip: GripEntries) -> ViewJson:
    """The entries that say where on the hand a camera is.

    Args:
        grip_from_camera: Array [4, 4].
        grip: Which numbers of the state are the hand's pose.
    """
    said = {f.name: getattr(grip, f.name) for f in fields(grip)}
    own = {f.name: said[f.name] for f in fields(grip) if said[f.name] != f.default}
    return {"grip_from_camera": _parts(grip_from_camera)} | ({"grip": own} if own else {})


def _parts(pose: np.ndarray) -> dict[str, list[float]]:
    quaternion = np.asarray(quaternion_from_matrix(pose[:3, :3]))
    return {
        "position": [round(float(x), 6) for x in pose[:3, 3]],
        "quaternion_wxyz": [round(float(x), 8) for x in quaternion],
    }


def check_updatable(path: Path) -> None:
    """Refuses a place for a file of calibrations that cannot be updated.

    Args:
        path: Where the file is, or is to be.

    Raises:
        ConfigError: There is something else; it would be lost.
    """
    if path.suffix != ".json":
        raise ConfigError(f"--cameras {path}: expected the name of a file that ends in .json.")
    if path.exists():
        read_cameras(path)


def update_cameras(path: Path, changes: Changes) -> Path:
    """Writes a file of calibrations, or changes one: other views and episodes in it stay.

    Views and episodes keep the names that they have in it. The new file is read as `--cameras`
    would be before it takes the old one's place.

    Args:
        path: Of the file, or of a link to it.
        changes: What becomes different.

    Returns:
        The path.

    Raises:
        ConfigError: What is there is no file of calibrations.
        DatasetError: It cannot be read, or its folder cannot be written to.
    """
    path = path.resolve()
    with exclusive(path):
        content: dict[str, Any] = {"format": FORMAT}
        if path.exists():
            check_updatable(path)
            content = read_json(path)
        views = content.setdefault("views", {})
        _change(views, changes.views)
        episodes = content.setdefault("episodes", {}) if changes.episodes else {}
        for number, own in changes.episodes.items():
            called = changes.called.get(number, number)
            _change(episodes.setdefault(called if called in episodes else number, {}), own)
        for own in (e for e in content.get("episodes", {}).values() if e):
            for name in (_name_in(own, view) for view in changes.everywhere):
                own[name] = {k: v for k, v in own.pop(name, {}).items() if k not in PLACED}
                if not own[name]:
                    del own[name]
        if changes.about:
            content["about"] = _about(content.get("about"), changes)
        with whole(path) as part:
            part.write_text(_text(content), encoding="utf-8")
            try:
                read_cameras(part)
            except JaxcamError as error:
                raise ConfigError(str(error).replace(str(part), str(path))) from error
    return path


def overruled(path: Path, view: str) -> list[str]:
    """Episodes that have a pose of their own for a view, which comes before the view's.

    Args:
        path: File of calibrations.
        view: The camera's name.
    """
    episodes = read_cameras(path).episodes
    content = read_json(path).get("episodes", {})
    own = {e: content[e].get(_name_in(content[e], view)) for e in episodes}
    return [e for e, entries in own.items() if set(entries or {}) & set(PLACED)]


def _name_in(entries: Mapping[str, Any], view: str) -> str:
    """What a view is called in a file."""
    return IMAGES + view if IMAGES + view in entries else view


def _change(entries: dict[str, Any], changes: Mapping[str, ViewJson]) -> None:
    for view, new in changes.items():
        name = _name_in(entries, view)
        entries[name] = _changed(entries.get(name) or {}, new)


def _changed(old: ViewJson, new: ViewJson) -> ViewJson:
    gone = {name for group in (PLACED, OPTICS) if set(group) & set(new) for name in group}
    return {k: v for k, v in old.items() if k not in gone} | new


def _about(old: Any, changes: Changes) -> dict[str, Any]:
    about = dict(old) if isinstance(old, dict) else {} if old is None else {"before": old}
    calibration = about.get("calibration")
    calibration = dict(calibration) if isinstance(calibration, dict) else {}
    date = datetime.date.today().isoformat()
    for view, entries in changes.about.items():
        known = calibration.get(view)
        known = dict(known) if isinstance(known, dict) else {}
        if view in changes.everywhere:  # poses of single episodes are gone
            known = {k: v for k, v in known.items() if _episodes_of(v) is None}
        again = {str(e) for note in entries.values() for e in _episodes_of(note) or ()}
        left = {k: _without(v, again) for k, v in known.items()}
        known = {k: v for k, v in left.items() if v is not None}
        notes = {k: _with_episodes(known.get(k), v) for k, v in entries.items()}
        calibration[view] = known | {k: {"date": date, **v} for k, v in notes.items()}
    return about | {"calibration": calibration}


def _without(note: Any, again: set[str]) -> Any:
    """A note without episodes that have another pose now; None if it was on no others."""
    episodes = _episodes_of(note)
    if not episodes:
        return note
    left = [e for e in episodes if str(e) not in again]
    others = {e: episodes[e] for e in left} if isinstance(episodes, dict) else left
    return note | {"episodes": others} if left else None


def _with_episodes(old: Any, new: dict[str, Any]) -> dict[str, Any]:
    """A note on some episodes is on those before, too: their poses are still there."""
    before, later = _episodes_of(old), _episodes_of(new)
    if isinstance(before, list) and isinstance(later, list):
        return new | {"episodes": before + later}
    if isinstance(before, dict) and isinstance(later, dict):
        return new | {"episodes": before | later}
    return new


def _episodes_of(note: Any) -> list[Any] | dict[str, Any] | None:
    """The episodes that a note is on, or what it says of each; None if it is on all of a view."""
    episodes = note.get("episodes") if isinstance(note, dict) else None
    return episodes if isinstance(episodes, list | dict) else None


def _text(content: Any, indent: int = 0) -> str:
    """JSON in which what fits on a line stands on one."""
    line = json.dumps(content, ensure_ascii=False)
    room = 100 - indent
    if len(line) <= room or not isinstance(content, dict | list) or not content:
        return line + ("\n" if indent == 0 else "")
    inner = " " * (indent + 2)
    if isinstance(content, dict):
        parts = [
            f"{inner}{json.dumps(name, ensure_ascii=False)}: {_text(value, indent + 2)}"
            for name, value in content.items()
        ]
        begin, end = "{", "}"
    else:
        parts = [f"{inner}{_text(value, indent + 2)}" for value in content]
        begin, end = "[", "]"
    text = f"{begin}\n" + ",\n".join(parts) + f"\n{' ' * indent}{end}"
    return text + ("\n" if indent == 0 else "")
