"""Files that say where cameras stood: `cameras.json`, and `meta/jaxcam.json` within a dataset.

    {
      "format": 1,
      "views": {
        "front": {
          "K": {"fx": 615.2, "fy": 615.0, "cx": 320.4, "cy": 239.1},
          "size": [640, 480],
          "pixel_centers": 0,
          "lens": "opencv",
          "distortion": [0.09, -0.24, 0.0004, -0.001, 0.18],
          "base_from_camera": {"position": [1.1, 0.0, 0.5], "quaternion_wxyz": [0, 0.5, 0.5, 0]}
        },
        "wrist": {"K": […], "size": [640, 480], "base_from_camera": "wrist.npz"}
      },
      "episodes": {"12": {"front": {"base_from_camera": […]}}}
    }

What an episode's entry leaves out, the view's has. `docs/calibrated-datasets.md` tells all of it,
and `docs/cameras.schema.json` is the same for editors.
"""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

import numpy as np

from jaxcam.config.fields import as_record
from jaxcam.config.names import ActionMeaning
from jaxcam.errors import ConfigError
from jaxcam.files.json import read_json
from jaxcam.interop.cameras.grips import GripEntries
from jaxcam.interop.cameras.optics import LensName, Optics, optics_of
from jaxcam.interop.cameras.poses import Axes, PoseFile, checked_pose, place_of
from jaxcam.rays import invert

POSES = ("base_from_camera", "world_from_camera", "grip_from_camera")
"""Entries of a view that say where it stands; one of them."""
IMAGES = "observation.images."
"""What LeRobot's features of views begin with, which files of calibrations may have too."""
FORMAT = 1
"""Number of the form that is written and read."""
NOTES = (
    "task", "scene", "action_space", "intrinsics", "fovy_deg", "image_size", "nominal_grip",
    "conventions", "source", "jaxcam",
)  # fmt: skip
"""What an export of ours has in its `meta/jaxcam.json` beside cameras; no calibration is in it."""


@dataclass(frozen=True)
class CamerasEntries:
    """The entries of a file of calibrations."""

    format: int
    """Number of the form."""
    views: dict[str, Any] = field(default_factory=dict)
    """`ViewEntries` by the view's name."""
    world_from_base: list[Any] | dict[str, Any] | None = None
    """Where the robot's base stands in the world, if poses are given in that."""
    episodes: dict[str, Any] = field(default_factory=dict)
    """By an episode's number or name: `ViewEntries` by the view's name, of what is different."""
    about: Any = None
    """Anything that the writer wants to keep: who calibrated, when, how well."""


@dataclass(frozen=True)
class ViewEntries:
    """The entries of one view."""

    K: list[Any] | dict[str, Any] | None = None
    """Three rows of three numbers, or `fx`, `fy`, `cx` and `cy`, in pixels of `size`."""
    size: tuple[int, int] | None = None
    """Width and height of the pictures that K is for."""
    pixel_centers: float | None = None
    """Coordinate of the first pixel's centre: 0.5 if left out, 0 in OpenCV's calibrations."""
    lens: LensName | None = None
    """Model of the lens: `opencv` if there is distortion, else `pinhole`."""
    distortion: tuple[float, ...] | None = None
    """Coefficients of the lens in OpenCV's order."""
    base_from_camera: list[Any] | dict[str, Any] | str | None = None
    """Pose in the robot's base frame; this or `world_from_camera`."""
    world_from_camera: list[Any] | dict[str, Any] | str | None = None
    """Pose in a world whose `world_from_base` the file has."""
    grip_from_camera: list[Any] | dict[str, Any] | None = None
    """Pose on the hand, of a camera that the hand carries; this or one of those two."""
    grip: dict[str, Any] | None = None
    """`GripEntries`: which numbers of a dataset's state are the hand's pose."""
    axes: Axes | None = None
    """Camera axes of the pose: `opencv` if left out, or `opengl`."""


@dataclass(frozen=True)
class Pose:
    """Where a camera stood, as a file says it."""

    place: np.ndarray | PoseFile
    """In the frame that the file uses: [4, 4], [T, 4, 4], or a file of those."""
    base_from_world: np.ndarray | None
    """Where that frame is not the base's, [4, 4]."""
    axes: Axes
    """Camera axes."""
    where: str
    """Which entry it is, for messages."""
    carried: GripEntries | None = None
    """Of a camera on the hand, which numbers are the hand's pose; its place is on the hand."""

    def of(
        self, episode: tuple[str, ...], hand: Callable[[GripEntries, str], np.ndarray] | None = None
    ) -> np.ndarray | None:
        """Base from camera in an episode, float64 [4, 4] or [T, 4, 4]; None if it has none.

        Args:
            episode: Its names.
            hand: The hand's poses in the base frame, [T, 4, 4], by which numbers they are, and by
                the name of the entry that says so; where nobody knows them, a camera on the hand
                has no pose.

        Raises:
            CameraError: It is no pose.
            JaxcamError: A file cannot be read.
        """
        place = self.place
        if isinstance(place, PoseFile):
            place = place.read(episode)
            if place is None:
                return None
        pose = checked_pose(place, self.where, self.axes)
        if self.carried is not None:
            return None if hand is None else hand(self.carried, self.where) @ pose
        return pose if self.base_from_world is None else self.base_from_world @ pose


@dataclass(frozen=True)
class Entry:
    """What a file says of a view, in all episodes or in one."""

    optics: Optics | None
    """How it sees, if it says so."""
    pose: Pose | None
    """Where it stood, if it says so."""


@dataclass(frozen=True)
class CamerasFile:
    """A file of calibrations that was read."""

    path: Path
    """Of the file."""
    views: Mapping[str, Entry]
    """By the view's name."""
    episodes: Mapping[str, Mapping[str, Entry]]
    """By an episode's number or name, then by the view's name."""

    def of(self, episode: tuple[str, ...], view: str) -> Entry:
        """What it says of a view in an episode.

        Args:
            episode: Its names, the first that the file has counts.
            view: Its name.
        """
        changes = next((self.episodes[name] for name in episode if name in self.episodes), {})
        return changes.get(view) or self.views.get(view) or Entry(None, None)


def read_cameras(path: Path) -> CamerasFile:
    """Reads a file of calibrations.

    Args:
        path: Of the file.

    Raises:
        ConfigError: It is no such file, of a newer form, or has a name or a value that is none.
        CameraError: A camera in it is impossible.
        DatasetError: It cannot be read.
    """
    return _read(path, read_json(path))


def read_notes(path: Path) -> CamerasFile | None:
    """Reads the calibrations of a dataset's `meta/jaxcam.json`.

    Args:
        path: Of the file.

    Returns:
        None where it is missing, or has none, as our exports: their rows have the cameras.

    Raises:
        ConfigError, CameraError, DatasetError: As `read_cameras`.
    """
    if not path.exists():
        return None
    content = read_json(path)
    if isinstance(content, dict):
        is_export = "conventions" in content and "views" not in content
        content = {k: v for k, v in content.items() if k not in NOTES}
        if is_export and set(content) <= {"world_from_base"}:
            return None
    return _read(path, content)


def noted_actions(path: Path) -> ActionMeaning:
    """What a dataset's actions are, if its `meta/jaxcam.json` says so, as our exports do.

    Args:
        path: Of the file, which may be missing.

    Raises:
        DatasetError: It cannot be read.
    """
    content = read_json(path) if path.exists() else None
    space = content.get("action_space") if isinstance(content, dict) else None
    return next((meaning for meaning in get_args(ActionMeaning) if meaning == space), "unknown")


def _by_view(entries: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Entries by their views' names, without what LeRobot's begin with."""
    if twice := [view for view in entries if IMAGES + view in entries]:
        raise ConfigError(f"{where}: {twice[0]!r:.80} and {IMAGES + twice[0]!r:.80} are one.")
    return {name.removeprefix(IMAGES): entry for name, entry in entries.items()}


def _read(path: Path, content: Any) -> CamerasFile:
    where = str(path)
    if isinstance(content, dict):
        content.pop("$schema", None)
    entries = as_record(CamerasEntries, content, where)
    if entries.format != FORMAT:
        newer = " It is of a newer jaxcam: update." if entries.format > FORMAT else ""
        raise ConfigError(f"{where}: format {entries.format}; expected {FORMAT}.{newer}")
    base_from_world = None
    if entries.world_from_base is not None:
        name = f"{where}: world_from_base"
        place = _one(place_of(entries.world_from_base, name, path.parent), name)
        base_from_world = np.asarray(invert(checked_pose(place, name)))
    given = _by_view(entries.views, where)
    views = {name: _view(f"{where}: view '{name}'", view) for name, view in given.items()}
    episodes: dict[str, dict[str, Entry]] = {}
    for number, changes in entries.episodes.items():
        place = f"{where}: episode '{number}'"
        if not isinstance(changes, dict):
            raise ConfigError(f"{place}: expected views by their names.")
        episodes[number] = {}
        for name, change in _by_view(changes, place).items():
            own = _view(f"{place}, view '{name}'", change)
            merged = _merged(views.get(name, ViewEntries()), own)
            episodes[number][name] = _entry(
                merged, f"{place}, view '{name}'", path.parent, base_from_world
            )
    read = {
        name: _entry(view, f"{where}: view '{name}'", path.parent, base_from_world)
        for name, view in views.items()
    }
    return CamerasFile(path, read, episodes)


def _view(where: str, content: Any) -> ViewEntries:
    return as_record(ViewEntries, content, where)


def _merged(view: ViewEntries, own: ViewEntries) -> ViewEntries:
    """What an episode says of a view, and what it leaves out of what holds for all."""
    said = {k: v for k, v in vars(own).items() if v is not None}
    if set(POSES) & set(said):
        none = dict.fromkeys((*POSES, "grip"))
        view = dataclasses.replace(view, **none)
    if {"lens", "distortion"} & set(said):
        view = dataclasses.replace(view, lens=None, distortion=None)
    return dataclasses.replace(view, **said)


def _entry(
    view: ViewEntries, where: str, folder: Path, base_from_world: np.ndarray | None
) -> Entry:
    optics = optics_of(vars(view), where)
    given = [name for name in POSES if getattr(view, name) is not None]
    if view.grip is not None and given != ["grip_from_camera"]:
        raise ConfigError(f"{where}: 'grip' belongs to 'grip_from_camera', a camera on the hand.")
    if not given:
        return Entry(optics, None)
    if len(given) > 1:
        raise ConfigError(f"{where}: both {' and '.join(given)}. Leave one out.")
    name = f"{where}: {given[0]}"
    in_world = given[0] == "world_from_camera"
    if in_world and base_from_world is None:
        raise ConfigError(
            f"{name} without 'world_from_base' beside 'views': where does the robot stand?"
        )
    place = place_of(getattr(view, given[0]), name, folder)
    if given[0] == "grip_from_camera":
        carried = as_record(GripEntries, view.grip or {}, f"{where}: grip")
        on_hand = checked_pose(_one(place, name), name)
        return Entry(optics, Pose(on_hand, None, view.axes or "opencv", name, carried))
    pose = Pose(place, base_from_world if in_world else None, view.axes or "opencv", name)
    if not isinstance(place, PoseFile):
        pose.of(())
    return Entry(optics, pose)


def _one(place: np.ndarray | PoseFile, where: str) -> np.ndarray:
    if isinstance(place, PoseFile) or place.ndim != 2:
        raise ConfigError(f"{where}: expected one pose.")
    return place
