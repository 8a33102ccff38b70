"""What a policy is sent of what the robot sees: the cameras that are used, and where they stand."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from jaxcam.client import CAMERA, IMAGES
from jaxcam.errors import ConfigError, PortError, closest
from jaxcam.interop.cameras.files import CamerasFile, Entry, read_cameras
from jaxcam.interop.cameras.optics import Optics


@dataclass(frozen=True)
class Calibrated:
    """A camera in one placement."""

    optics: Optics
    """How it sees."""
    base_from_camera: np.ndarray
    """Where it stands, [4, 4]."""


def calibrations(
    file: CamerasFile, names: Sequence[str], placement: str
) -> tuple[dict[str, Calibrated], list[str]]:
    """Cameras as a file has them.

    Args:
        file: The file.
        names: Of the cameras.
        placement: Where they stand, as the file calls it; empty if they never move.

    Returns:
        By the name, and what the file lacks, in words.
    """
    known: dict[str, Calibrated] = {}
    lacking = []
    if placement and placement not in file.episodes:
        hint = closest(placement, file.episodes) if file.episodes else ", nor any other"
        return {}, [f"{file.path} has no placement {placement!r} among its episodes{hint}"]
    for name in names:
        entry: Entry = file.of((placement,), name)
        pose = entry.pose.of((placement,)) if entry.pose else None
        if entry.optics is None or pose is None or pose.ndim != 2:
            part = "K" if entry.optics is None else "single pose"
            at = f" at placement {placement!r}" if placement else ""
            lacking.append(f"{file.path} has no {part} of the camera {name!r}{at}")
        else:
            known[name] = Calibrated(entry.optics, pose)
    return known, lacking


def read_calibrations(path: Path, names: Sequence[str]) -> CamerasFile:
    """A file of calibrations that knows these cameras, at some placement at least.

    Args:
        path: Of the file.
        names: Of the cameras.

    Raises:
        ConfigError: It has never heard of one of them; or the file is none.
        CameraError: A camera in it is impossible.
        DatasetError: It cannot be read.
    """
    file = read_cameras(path)
    heard = {*file.views, *(view for views in file.episodes.values() for view in views)}
    for name in names:
        if name not in heard:
            hint = closest(name, sorted(heard)) if heard else ". It has none."
            raise ConfigError(f"cameras: {path} has no view {name!r}{hint}")
    return file


@dataclass(frozen=True)
class PolicySight:
    """What of an observation goes to a policy, and under which names."""

    cameras: tuple[str, ...] = ()
    """All of the robot's; without any, observations go as they are."""
    views: Mapping[str, str] = field(default_factory=dict)
    """Of the cameras that are used, what the policy calls each."""
    known: Mapping[str, Calibrated] = field(default_factory=dict)
    """Where the cameras stand, as far as the policy is to be told."""
    prompt: str | None = None
    """The task in words."""

    def request(self, observation: Mapping[str, Any]) -> dict[str, Any]:
        """The observation as the policy is sent it.

        What it says itself of a camera, such as the pose of one that moves, comes first.

        Args:
            observation: `observation.images.<camera>` of every camera, `observation.state`, and
                anything else.

        Raises:
            PortError: A picture of a camera that is used is missing, or is none.
        """
        request: dict[str, Any] = {} if self.prompt is None else {"prompt": self.prompt}
        for key, value in observation.items():
            name = self._named(str(key).replace("/", "."))
            if name:
                request[name] = value
        for camera, view in self.views.items():
            picture = request.get(IMAGES + view)
            if picture is None:
                pictures = [k for k in observation if str(k).replace("/", ".").startswith(IMAGES)]
                raise PortError(
                    f"No picture of the camera {camera!r}: expected {IMAGES}{camera}, uint8 "
                    f"[H, W, 3]; the pictures that came are {', '.join(pictures) or 'none'}."
                )
            request |= self._calibration(camera, view, np.shape(picture)) | {
                k: v for k, v in request.items() if k.startswith(f"{CAMERA}{view}.")
            }
        return request

    def _named(self, key: str) -> str:
        """What the policy calls an entry; empty if it is of a camera that is not used."""
        for start in (IMAGES, CAMERA):
            if not key.startswith(start):
                continue
            of = [n for n in self.cameras if f"{key}.".startswith(f"{start}{n}.")]
            if of:
                camera = max(of, key=len)  # names may have dots
                rest = key[len(start) + len(camera) :]
                return f"{start}{self.views[camera]}{rest}" if camera in self.views else ""
        return key

    def _calibration(self, camera: str, view: str, shape: Sequence[int]) -> dict[str, Any]:
        if camera not in self.known:
            return {}
        if len(shape) < 3:
            raise PortError(
                f"The picture of {camera!r} has shape {list(shape)}; expected [H, W, 3]."
            )
        calibrated, optics = self.known[camera], self.known[camera].optics
        entries: dict[str, Any] = {
            "intrinsics": optics.at(shape[-3], shape[-2], camera).astype(np.float32),
            "base_from_camera": calibrated.base_from_camera.astype(np.float32),
        }
        if optics.distortion.any():
            entries["distortion"] = optics.distortion.astype(np.float32)
        return {f"{CAMERA}{view}.{name}": value for name, value in entries.items()}


def views_for(cameras: Sequence[str], views: Sequence[str]) -> dict[str, str]:
    """Which camera stands for which view of a policy.

    A camera that the policy knows by name is that view; the others take what is left, in order.
    A policy may know more views than it sees at once.

    Args:
        cameras: That are used.
        views: The policy's; as the cameras are called where it does not say.
    """
    if not views:
        return {camera: camera for camera in cameras}
    same = {camera: camera for camera in cameras if camera in views}
    rest = [view for view in views if view not in same]
    rest += cameras[len(views) :]  # a server that names fewer views than it sees
    others = iter(rest)
    return {camera: same.get(camera) or next(others) for camera in cameras}
