"""Cameras that stand where a file says, so that requests need not say it."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxcam.errors import ConfigError
from jaxcam.interop.cameras.files import read_cameras
from jaxcam.interop.cameras.optics import Optics
from jaxcam.interop.cameras.poses import PoseFile


@dataclass(frozen=True)
class FixedCamera:
    """What a file says of a camera."""

    optics: Optics | None = None
    """How it sees, if it says so."""
    base_from_camera: np.ndarray | None = None
    """Where it stands, OpenCV axes, float64 [4, 4], if it says so; of one on the hand, it does not:
    requests do."""


@dataclass(frozen=True)
class Rig:
    """The cameras of a file."""

    cameras: Mapping[str, FixedCamera]
    """By the view's name, of those that the policy may see."""
    others: tuple[str, ...] = ()
    """Names in the file that are no such view's."""

    def says_all_of(self, views: tuple[str, ...]) -> bool:
        """Whether requests need to say nothing of the cameras of some views."""
        cameras = [self.cameras.get(view, FixedCamera()) for view in views]
        return all(c.optics and c.base_from_camera is not None for c in cameras)


def read_rig(path: Path, views: tuple[str, ...]) -> Rig:
    """Reads where cameras stand.

    Args:
        path: A file as `docs/calibrated-datasets.md` describes it.
        views: Names of those that the policy may see.

    Raises:
        ConfigError: It is no such file, has no camera of the policy's, or says something that
            holds for some pictures or episodes only.
        CameraError: A camera in it is impossible.
        DatasetError: It cannot be read.
    """
    file = read_cameras(path)
    if file.episodes:
        raise ConfigError(
            f"{path}: 'episodes' are for recorded datasets. Give a server the cameras as they "
            "stand now, in 'views'."
        )
    cameras = {}
    for view, entry in file.views.items():
        if view not in views:
            continue
        pose = None
        if entry.pose is not None and entry.pose.carried is None:
            pose = None if isinstance(entry.pose.place, PoseFile) else entry.pose.of(())
            if pose is None or pose.ndim != 2:
                raise ConfigError(
                    f"{entry.pose.where}: poses picture by picture are for recorded datasets. "
                    "Leave them out, and let each request say where a camera that moves is: "
                    f"camera.{view}.base_from_camera."
                )
        cameras[view] = FixedCamera(entry.optics, pose)
    others = tuple(name for name in file.views if name not in views)
    if not cameras:
        raise ConfigError(
            f"{path} has no camera of the policy's views ({', '.join(views)}), but of "
            f"{', '.join(others) or 'none'}."
        )
    return Rig(cameras, others)
