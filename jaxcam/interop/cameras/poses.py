"""Poses of cameras as people write them: matrices, quaternions, or arrays in files."""

import zipfile
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from jaxcam.config.fields import as_record, short
from jaxcam.data.hdf5 import LARGEST_ARRAY, require_file
from jaxcam.errors import CameraError, ConfigError, DatasetError
from jaxcam.files.paths import inside
from jaxcam.rays import check_pose, opencv_from_opengl
from jaxcam.rays.rotations import matrix_from_quaternion, nearest_rotation

Axes = Literal["opencv", "opengl"]
"""Camera axes of poses in files: y down and z forward, or y up and z backward."""
UNIT = 1e-3
"""How far the length of a written quaternion may be from 1."""
ROUNDED = 1e-6
"""Entries of |RᵀR - I| beyond which a rotation was written with few digits, and is mended."""


@dataclass(frozen=True)
class PositionAndQuaternion:
    """A pose, or one a picture, without a matrix."""

    position: list[Any]
    """Metres [3] or [T, 3]."""
    quaternion_wxyz: list[Any]
    """Of length one [4] or [T, 4]."""


@dataclass(frozen=True)
class PoseFile:
    """Poses in a NumPy file beside the file that names it.

    A .npy is one array, [4, 4] or [T, 4, 4]; a .npz has an array for each episode, by its number or
    its name.
    """

    path: Path
    """Of the file."""
    folder: Path
    """Which it must not lead out of."""

    def read(self, episode: Iterable[str]) -> np.ndarray | None:
        """The array of an episode, or of all.

        Args:
            episode: Names that an array in an .npz may have.

        Returns:
            Float64, of any shape; None where a .npz has none of this episode.

        Raises:
            ConfigError: The file may not be read, or is of another kind.
            DatasetError: There is none, or it is damaged.
        """
        if not inside(self.path, self.folder):
            raise ConfigError(f"{self.path} leads out of {self.folder}. Put it in that folder.")
        require_file(self.path)
        try:
            array = self._npz(episode) if self.path.suffix == ".npz" else self._npy()
        except (OSError, ValueError, EOFError, MemoryError, RuntimeError, zlib.error) as error:
            raise DatasetError(
                f"{self.path}: no array of numbers, or damaged ({error})."
            ) from error
        except zipfile.BadZipFile as error:
            raise DatasetError(f"{self.path}: damaged ({error}).") from error
        if array is not None and array.dtype.kind not in "if":
            raise DatasetError(f"{self.path}: {array.dtype}; expected numbers.")
        return None if array is None else np.array(array, np.float64)

    def _npy(self) -> np.ndarray:
        array = np.load(self.path, mmap_mode="r", allow_pickle=False)
        if not isinstance(array, np.ndarray) or array.nbytes > LARGEST_ARRAY:
            raise ValueError(f"at most {LARGEST_ARRAY / 1e6:.0f} MB of one array are read")
        return array

    def _npz(self, episode: Iterable[str]) -> np.ndarray | None:
        packed = self._packed
        name = next((n for n in (f"{e}.npy" for e in episode) if n in packed.NameToInfo), None)
        if name is None:
            return None
        if packed.getinfo(name).file_size > LARGEST_ARRAY:
            raise ValueError(f"at most {LARGEST_ARRAY / 1e6:.0f} MB of one array are read")
        with packed.open(name) as file:
            return np.lib.format.read_array(file, allow_pickle=False)

    @cached_property
    def _packed(self) -> zipfile.ZipFile:
        """The .npz, open: its list of arrays is as long as there are episodes."""
        return zipfile.ZipFile(self.path)


def place_of(value: Any, where: str, folder: Path) -> np.ndarray | PoseFile:
    """What a JSON text says of where a camera, or the robot's base, stood.

    Args:
        value: Four rows of four numbers, T times that, a position and a quaternion, or the name of
            a file beside the text.
        where: What it is, for messages.
        folder: Of the text.

    Returns:
        Float64, [4, 4] or [T, 4, 4] unless it is no pose, which `checked_pose` finds; or a file.

    Raises:
        ConfigError: It is something else.
    """
    if isinstance(value, str):
        path = folder / value
        if path.suffix not in (".npy", ".npz"):
            raise ConfigError(f"{where}: {value!r:.80} is no name of a .npy or .npz file.")
        return PoseFile(path, folder)
    if not isinstance(value, dict):
        return real_numbers(value, where)
    parts = as_record(PositionAndQuaternion, value, where)
    position = real_numbers(parts.position, f"{where}: position")
    quaternion = real_numbers(parts.quaternion_wxyz, f"{where}: quaternion_wxyz")
    if position.shape[-1:] != (3,) or quaternion.shape != (*position.shape[:-1], 4):
        raise ConfigError(
            f"{where}: position {list(position.shape)} and quaternion_wxyz "
            f"{list(quaternion.shape)}; expected [3] and [4], or [T, 3] and [T, 4]."
        )
    length = np.linalg.norm(quaternion, axis=-1, keepdims=True)
    if not (np.abs(length - 1) <= UNIT).all():
        raise CameraError(
            f"{where}: a quaternion of length {float(length.flat[0]):g}; expected 1. Likely cause: "
            "too few digits, or numbers that are no quaternion."
        )
    pose = np.zeros((*position.shape[:-1], 4, 4))
    pose[..., :3, :3] = matrix_from_quaternion(quaternion / length)
    pose[..., :3, 3], pose[..., 3, 3] = position, 1
    return pose


def checked_pose(pose: np.ndarray, where: str, axes: Axes = "opencv") -> np.ndarray:
    """Poses that are rigid, in OpenCV axes; written with few digits, their rotations are mended.

    Args:
        pose: Of one camera, [4, 4] or [T, 4, 4].
        where: Whose, for messages.
        axes: What the camera's axes are.

    Raises:
        CameraError: Naming the pose, the check, expected and got, and the likely cause.
    """
    check_pose(where, pose)
    if pose.ndim > 3 or not pose.size:
        raise CameraError(f"{where}: shape {list(pose.shape)}; expected [4, 4] or [T, 4, 4].")
    rotation = pose[..., :3, :3]
    if (np.abs(np.swapaxes(rotation, -1, -2) @ rotation - np.eye(3)) > ROUNDED).any():
        pose = pose.copy()
        pose[..., :3, :3] = nearest_rotation(rotation)
    return np.asarray(opencv_from_opengl(pose)) if axes == "opengl" else pose


def real_numbers(value: Any, where: str) -> np.ndarray:
    """Lists of numbers, of a JSON text, as an array; float64.

    Args:
        value: The lists.
        where: What they are, for messages.

    Raises:
        ConfigError: There is something else in them, or their lengths differ.
    """
    try:
        array = np.asarray(value)
    except (ValueError, TypeError, OverflowError, RecursionError):
        array = np.asarray(None)
    if array.dtype.kind not in "if" or not array.size:
        raise ConfigError(f"{where}: expected lists of numbers of one length, got {short(value)}.")
    return array.astype(np.float64)
