"""Recorded episodes and files of calibrations as exhibits, without a simulator."""

from pathlib import Path

import cv2
import numpy as np

from jaxcam.data.recorded.parts import meaning_of
from jaxcam.data.recorded.recording import Calibration, Recording, Sight
from jaxcam.errors import DatasetError
from jaxcam.interop.cameras.files import Entry, read_cameras
from jaxcam.rays import Camera
from jaxcam.viewer.exhibit import FIRST, GREEN, RED, RGB, Exhibit, Viewpoint, Way

WIDEST = 320
"""Columns of a shown picture at most."""
SHOWN = 360
"""Pictures of an episode that are shown at most, evenly spread over its cameras."""


def episode(recording: Recording, number: int, grip: str = "") -> Exhibit:
    """One recorded episode.

    Args:
        recording: The dataset, with its calibrations.
        number: Of the episode.
        grip: Where its state has the grip's position; by names when empty.

    Raises:
        DatasetError: Nobody says of any camera where it stood, or a picture cannot be decoded.
        ConfigError: `grip` names no three columns of the state.
    """
    shown = recording.episodes[number]
    held_out = number in recording.valid
    calibrated = {
        view: (sight, sight.calibration)
        for view, sight in shown.sights.items()
        if sight.calibration is not None
    }
    if not calibrated:
        raise DatasetError(
            f"{recording.path}: nobody says where the cameras of episode '{shown.name}' stood, so "
            "there is nothing to show. Give --cameras cameras.json; docs/calibrated-datasets.md "
            "says how to get one."
        )
    stride = -(-shown.length * len(calibrated) // SHOWN)
    columns = meaning_of(recording, grip).grip
    notes = [f"View {v}: nobody says where it stood." for v in shown.sights if v not in calibrated]
    if stride > 1:
        notes.append(f"Pictures are shown at every {stride}th step.")
    ways: tuple[Way, ...] = ()
    if columns is None:
        notes.append("No names say where the state has the grip: its way is not shown, see --grip.")
    else:
        points = shown.state[:, list(columns)].astype(float)
        ways = (Way("grip", (240, 196, 25), points),)
    kind = "held out" if held_out else "for training"
    group, colour = ("test", RED) if held_out else ("training", GREEN)
    return Exhibit(
        title=recording.path.name,
        subtitle=f"{shown.name}, {kind}. {shown.instruction}".strip(),
        rate=recording.rate,
        viewpoints=tuple(
            _viewpoint(view, (group, colour), sight, calibration, stride)
            for view, (sight, calibration) in calibrated.items()
        ),
        ways=ways,
        notes=tuple(notes),
    )


def _viewpoint(
    view: str, group: tuple[str, RGB], sight: Sight, calibration: Calibration, stride: int
) -> Viewpoint:
    camera = Camera(
        calibration.K,
        calibration.base_from_camera,
        sight.height,
        sight.width,
        calibration.distortion if np.any(calibration.distortion) else None,
    )
    scale = min(1.0, WIDEST / sight.width)
    camera = camera.resize(max(1, round(scale * sight.height)), max(1, round(scale * sight.width)))
    steps, pictures = [], []
    for t, picture in enumerate(sight.decode()):
        if t % stride == 0:
            size = (camera.width, camera.height)
            steps.append(t)
            pictures.append(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
    return Viewpoint(view, *group, camera, pictures, steps)


def calibrated_cameras(path: Path) -> Exhibit:
    """The cameras of a file of calibrations.

    Args:
        path: Of the file.

    Raises:
        ConfigError, CameraError, DatasetError: As `jaxcam.interop.cameras.files.read_cameras`; and
            there is no camera whose K and pose it has.
    """
    file = read_cameras(path)
    entries = [("", view, entry) for view, entry in file.views.items()]
    entries += [
        (name, view, entry)
        for name, views in file.episodes.items()
        for view, entry in views.items()
    ]
    same: dict[tuple[str, ...], list[tuple[str, Camera]]] = {}
    notes = []
    for name, view, entry in entries:
        title = f"episode {name}: {view}" if name else view
        camera = _camera(entry, name)
        if camera is None:
            lacks = "K" if entry.optics is None else "a pose that holds without a dataset"
            notes.append(f"{title} has not {lacks}: it is not shown.")
        else:
            values = [repr(np.asarray(value).tolist()) for value in vars(camera).values()]
            same.setdefault((view, *values), []).append((title, camera))
    viewpoints = [_standing([title for title, _ in one], one[0][1]) for one in same.values()]
    if not viewpoints:
        raise DatasetError(
            f"{path}: no camera has both K and a pose, so there is nothing to show. "
            + " ".join(notes)
        )
    return Exhibit(
        title=path.name,
        subtitle=f"{len(viewpoints)} calibrated camera{'s' * (len(viewpoints) != 1)}",
        viewpoints=tuple(viewpoints),
        notes=tuple(notes),
    )


def _standing(titles: list[str], camera: Camera) -> Viewpoint:
    """A camera that stood still under all these titles."""
    others = f" and {len(titles) - 1} more" if titles[1:] else ""
    return Viewpoint(titles[0] + others, "calibrated", FIRST, camera, known_as=tuple(titles))


def _camera(entry: Entry, name: str) -> Camera | None:
    """The camera of an entry, or None where it lacks half."""
    pose = entry.pose.of((name,) if name else ()) if entry.pose else None
    if entry.optics is None or pose is None:
        return None
    optics = entry.optics
    lens = optics.distortion if np.any(optics.distortion) else None
    return Camera(optics.K, pose, optics.height, optics.width, lens).validate(name or "camera")
