"""Recorded datasets in whatever layout they come: LeRobot's or DROID's, with their calibrations."""

from dataclasses import replace
from pathlib import Path

from rich.console import Console

from jaxcam.data.recorded.recording import Recording
from jaxcam.data.recorded.spaces import named_meaning
from jaxcam.errors import DatasetError
from jaxcam.interop.calibrations import NOTES, calibrated
from jaxcam.interop.cameras.files import noted_actions
from jaxcam.interop.droid.reading import read_droid
from jaxcam.interop.formats import recognise


def is_recording(path: Path) -> bool:
    """Whether a folder is in a layout that `read_recording` knows."""
    return path.is_dir() and recognise(path) in ("lerobot", "droid")


def read_recording(
    path: Path, cameras: Path | None = None, console: Console | None = None
) -> Recording:
    """A recorded dataset, with where its cameras stood as far as anybody says.

    Args:
        path: Its folder.
        cameras: JSON file of calibrations.
        console: For progress, and for where each calibration is from; silent when None.

    Raises:
        DatasetError: It is in no layout that is known, or damaged.
        ConfigError: A file of calibrations has a name or a value that is none, or the extra that
            reads the layout is not installed.
        CameraError: A calibration is impossible.
    """
    match recognise(path):
        case "lerobot":
            from jaxcam.interop.lerobot.reading import read_lerobot  # needs the extra `lerobot`

            recording = read_lerobot(path, console=console)
            recording = replace(recording, action_is=noted_actions(path / NOTES))
        case "droid":
            recording = read_droid(path, console=console)
        case _:
            raise DatasetError(
                f"{path}: a folder, but no recorded dataset: it has neither meta/info.json "
                "(LeRobot) nor trajectory.h5 (DROID). Simulated demonstrations are in files."
            )
    if recording.action_is == "unknown":
        recording = replace(recording, action_is=named_meaning(recording))
    return calibrated(recording, cameras, console)
