"""Recorded datasets in whatever layout they come: LeRobot's or DROID's, with their calibrations."""

from pathlib import Path

from jaxcam.data.recordings import Recording
from jaxcam.errors import DatasetError
from jaxcam.interop.calibrations import calibrated
from jaxcam.interop.droid import is_droid, read_droid
from jaxcam.interop.lerobot.reading import read_lerobot


def is_recording(path: Path) -> bool:
    """Whether a folder is in a layout that `read_recording` knows."""
    return (path / "meta" / "info.json").is_file() or is_droid(path)


def read_recording(path: Path, cameras: Path | None = None) -> Recording:
    """A recorded dataset, with where its cameras stood as far as anybody says.

    Args:
        path: Its folder.
        cameras: JSON file of calibrations.

    Raises:
        DatasetError: It is in no layout that is known, or damaged.
        CameraError: A calibration is impossible.
    """
    if (path / "meta" / "info.json").is_file():
        return calibrated(read_lerobot(path), cameras)
    if is_droid(path):
        return calibrated(read_droid(path), cameras)
    raise DatasetError(
        f"{path}: a folder, but no recorded dataset: it has neither meta/info.json (LeRobot) nor "
        "trajectory.h5 (DROID). Datasets of demonstrations that were simulated are files."
    )
