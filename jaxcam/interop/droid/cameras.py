"""DROID's cameras: which is which, where they stood, and how they saw."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from jaxcam.data.hdf5 import group_at, numbers
from jaxcam.data.recorded.recording import Placement
from jaxcam.errors import DatasetError
from jaxcam.interop.cameras.optics import Optics
from jaxcam.interop.cameras.poses import real_numbers
from jaxcam.interop.cameras.six_numbers import placement_of, poses_of
from jaxcam.interop.droid.annotations import Annotations, Metadata
from jaxcam.interop.droid.videos import Video
from jaxcam.rays import invert
from jaxcam.rays.lens import PACKED

VIEWS = {"ext1": "exterior_1_left", "ext2": "exterior_2_left", "wrist": "wrist_left"}
"""The cameras in metadata, and what LeRobot's form of DROID calls their left eyes."""
INTRINSICS_SIZE = (1280, 720)
"""Width and height that DROID's intrinsics are for; they count pixels as OpenCV does."""
HAND = 0
"""Type of a camera on the hand, in `observation/camera_type`."""


@dataclass(frozen=True)
class OpenEpisode:
    """An episode whose file is open."""

    file: h5py.File
    """Its `trajectory.h5`."""
    metadata: Metadata
    """Of the episode."""
    annotations: Annotations
    """Of all episodes."""
    steps: np.ndarray
    """Numbers of the steps that are used [T]."""

    @property
    def observation(self) -> h5py.Group:
        """What was seen and felt."""
        return group_at(self.file, "observation")

    def rows(self, group: str, name: str) -> np.ndarray | None:
        """An array of a group of what was observed, in the steps that are used; None without one.

        Raises:
            DatasetError: It is too short, or damaged.
        """
        if group not in self.observation:
            return None
        arrays = group_at(self.observation, group)
        if name not in arrays:
            return None
        array = numbers(arrays, name)
        if array.ndim < 2 or len(array) <= self.steps.max():
            raise DatasetError(
                f"{self.file.filename}: observation/{group}/{name}: shape {list(array.shape)}; "
                f"expected numbers of each of more than {self.steps.max()} steps."
            )
        return array[self.steps]


def roles_of(metadata: Metadata, file: h5py.File) -> dict[str, str]:
    """Which camera is which, by its serial: by metadata, else as DROID's own code sorts them.

    Raises:
        DatasetError: Neither says.
    """
    serials = {role: getattr(metadata, f"{role}_cam_serial") for role in VIEWS}
    if any(serials.values()):
        return {serial: role for role, serial in serials.items() if serial}
    types = group_at(group_at(file, "observation"), "camera_type")
    names = sorted(str(serial) for serial in types)
    hand = [s for s in names if numbers(types, s).reshape(-1)[:1].tolist() == [HAND]]
    others = zip([s for s in names if s not in hand], ("ext1", "ext2"), strict=False)
    return dict.fromkeys(hand[:1], "wrist") | dict(others)


def placement(episode: OpenEpisode, serial: str, role: str, video: Video) -> Placement | None:
    """What DROID says of a camera: recalibrated, step by step, or in metadata; None if nothing.

    Args:
        episode: The episode.
        serial: Of the camera.
        role: "ext1", "ext2" or "wrist".
        video: Its pictures.

    Raises:
        CameraError: Its six numbers are no pose, or its K is none of its pictures.
        DatasetError: Something is damaged.
    """
    pose = _pose(episode, serial, role)
    K, K_source = _intrinsics(episode, serial, video)
    if pose is None and K is None:
        return None
    base_from_camera, source = (pose.base_from_camera, pose.source) if pose else (None, "")
    return Placement(base_from_camera, source, K, K_source)


def _pose(episode: OpenEpisode, serial: str, role: str) -> Placement | None:
    uuid = episode.metadata.uuid
    if role != "wrist":
        for path, entries in episode.annotations.extrinsics.items():
            if (six := _entry(path, entries, uuid, serial, 6)) is not None:
                where = f"{path}: {uuid}, camera {serial}"
                if pose := placement_of(six, where, f"DROID's {path.name}"):
                    return pose
    name = f"{serial}_left"
    if (six := episode.rows("camera_extrinsics", name)) is not None:
        where = f"{episode.file.filename}: observation/camera_extrinsics/{name}"
        if pose := placement_of(six, where, "DROID's extrinsics of each step"):
            return pose
    six = getattr(episode.metadata, f"{role}_cam_extrinsics")
    if six is None:
        return None
    where = f"{Path(episode.file.filename).parent}: {role}_cam_extrinsics of its metadata"
    pose = placement_of(np.asarray(six, np.float64), where, "DROID's metadata")
    if role != "wrist" or pose is None or pose.base_from_camera is None:
        return pose
    source = f"{pose.source}, carried along by the grip"
    return Placement(_carried(episode, pose.base_from_camera), source)


def _carried(episode: OpenEpisode, first: np.ndarray) -> np.ndarray:
    """A camera on the hand, of which metadata has the pose at the first step of the episode."""
    robot = group_at(episode.observation, "robot_state")
    where = f"{episode.file.filename}: observation/robot_state/cartesian_position"
    base_from_grip = poses_of(numbers(robot, "cartesian_position"), where)
    grip_from_camera = invert(base_from_grip[0]) @ first
    return base_from_grip[episode.steps] @ grip_from_camera


def _intrinsics(episode: OpenEpisode, serial: str, video: Video) -> tuple[np.ndarray | None, str]:
    """K in pixels of the pictures, and where it is from."""
    path, entries = episode.annotations.intrinsics
    uuid, source = episode.metadata.uuid, f"DROID's {path.name}"
    where = f"{path}: {uuid}, camera {serial}"
    four = _entry(path, entries, uuid, serial, 4)
    if four is not None:
        fx, cx, fy, cy = four
        K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    else:
        name = f"{serial}_left"
        each = episode.rows("camera_intrinsics", name)
        where = f"{episode.file.filename}: observation/camera_intrinsics/{name}"
        if each is None or each.shape[1:] != (3, 3):
            return None, ""
        K, source = each[0], "DROID's intrinsics of each step"
    K = K + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    optics = Optics(K, *INTRINSICS_SIZE, np.zeros(PACKED))
    return optics.at(video.height, video.width, where), source


def _entry(
    path: Path, entries: dict[str, Any], uuid: str, serial: str, count: int
) -> np.ndarray | None:
    """Numbers that the authors found for a camera in an episode; None where they did not."""
    cameras = entries.get(uuid)
    if not isinstance(cameras, dict) or serial not in cameras:
        return None
    where = f"{path}: {uuid}, camera {serial}"
    values = real_numbers(cameras[serial], where)
    if values.shape != (count,):
        raise DatasetError(f"{where}: shape {list(values.shape)}; expected {count} numbers.")
    return values
