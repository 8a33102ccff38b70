"""What is known of a view before it is calibrated: that it is there, and how it sees."""

from pathlib import Path

from jaxcam.data.recorded.recording import Recording
from jaxcam.errors import ConfigError, closest
from jaxcam.interop.calibrations import pose_before
from jaxcam.interop.cameras.files import CamerasFile, read_cameras
from jaxcam.interop.cameras.optics import Optics


def require_view(view: str, recording: Recording) -> None:
    """Refuses a name that is none of the dataset's views.

    Args:
        view: What was given as --view.
        recording: The dataset.

    Raises:
        ConfigError: It has no such view.
    """
    if view not in recording.views:
        raise ConfigError(f"--view: unknown {view!r}{closest(view, recording.views)}")


def not_used_note(recording: Recording, view: str, cameras: Path) -> str:
    """That a pose in a file of calibrations is not the one that counts; empty where it is.

    Args:
        recording: The dataset.
        view: The camera's name.
        cameras: The file.
    """
    other = pose_before(recording, view, cameras)
    if not other:
        return ""
    remedy = (
        f"give --cameras {other}" if other.endswith(".json") else "take them out of the dataset"
    )
    return (
        f"The pose of view {view} is not read from {cameras}: {other} comes first "
        f"(docs/calibrated-datasets.md). To have this one used, {remedy}."
    )


def optics_of_view(cameras: Path, view: str, size: tuple[int, int]) -> Optics:
    """K and lens of a view, for pictures of a size.

    Args:
        cameras: File of calibrations.
        view: The camera's name.
        size: Width and height of the pictures.

    Raises:
        ConfigError: The file does not say.
        CameraError: K is for pictures of another shape.
        DatasetError: The file cannot be read.
    """
    if not cameras.exists():
        raise ConfigError(f"{cameras}: no such file. {_remedy(view)}")
    file = read_cameras(cameras)
    entry = file.of((), view)
    if entry.optics is None:
        raise ConfigError(f"{cameras}: {_lacks(file, view)} {_remedy(view)}")
    K = entry.optics.at(size[1], size[0], f"{cameras}: view '{view}'")
    return Optics(K, *size, entry.optics.distortion)


def _lacks(file: CamerasFile, view: str) -> str:
    if view in file.views:
        return f"view '{view}' has no K."
    return f"no view '{view}'{closest(view, file.views) if file.views else '.'}"


def _remedy(view: str) -> str:
    return (
        "A pose needs K and the lens first: python -m jaxcam.calibrate lens PICTURES "
        f"--view {view}, or write them into the file (docs/calibrated-datasets.md)."
    )
