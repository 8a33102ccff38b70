"""The pictures that are looked at: chosen by how the joints move, their lens undone."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from jaxcam.data.recorded.recording import Recording, Sight
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.files.paths import read_bytes
from jaxcam.interop.cameras.optics import Optics
from jaxcam.interrupts import check_stop
from jaxcam.rays.lens import distort
from jaxcam.robot.calibration.arm.film import Film
from jaxcam.robot.calibration.arm.joints import JointNumbers, joints_of
from jaxcam.robot.calibration.known import optics_of_view

HIGH = 320
"""Rows of the pictures that are looked at, at most."""
MASKS = 1 << 31
"""Bytes of a file of masks."""
MaskTable = dict[tuple[int, int], np.ndarray]
"""Masks by the episode's number and the step."""


def optics_for(recording: Recording, view: str, cameras: Path) -> Optics:
    """K and lens of a view, of the file of calibrations if it says them, else the dataset's own.

    Args:
        recording: The dataset.
        view: The camera's name.
        cameras: File of calibrations.

    Raises:
        ConfigError: Neither says them.
        DatasetError: No episode was seen by the view.
    """
    sight = next((e.sights[view] for e in recording.episodes if view in e.sights), None)
    if sight is None:
        raise DatasetError(f"No episode was seen by view '{view}'.")
    size = sight.width, sight.height
    own = sight.calibration is not None or (sight.placement and sight.placement.K is not None)
    try:
        return optics_of_view(cameras, view, size)
    except ConfigError:
        if not own:
            raise
    if sight.calibration is not None:
        K, lens = sight.calibration.K, sight.calibration.distortion
        return Optics(np.reshape(K, (-1, 3, 3))[0].astype(float), *size, np.asarray(lens))
    placement = sight.placement
    assert placement is not None
    assert placement.K is not None
    lens = np.zeros(9) if placement.distortion is None else placement.distortion
    return Optics(placement.K.astype(float), *size, lens)


def chosen_steps(angles: np.ndarray, most: int) -> np.ndarray:
    """Steps of an episode, evenly spaced along the way that its joints go, [at most `most`].

    Args:
        angles: Of the joints, [T, joints].
        most: How many.
    """
    way = np.r_[0, np.cumsum(np.linalg.norm(np.diff(angles, axis=0), axis=-1))]
    at = np.searchsorted(way, np.linspace(0, way[-1], most) - 1e-9)
    return np.unique(np.clip(at, 0, len(angles) - 1))


class Straightener:
    """Undoes a lens, and makes large pictures smaller.

    Args:
        optics: How the camera sees.
    """

    def __init__(self, optics: Optics) -> None:
        scale = min(1.0, HIGH / optics.height)
        self.size = round(optics.width * scale), round(optics.height * scale)
        self.K = optics.K.copy()
        self.K[:2] *= (np.array(self.size) / (optics.width, optics.height))[:, None]
        self._own = optics.width, optics.height
        self._map = None
        if optics.distortion.any():
            x, y = np.meshgrid(np.arange(self._own[0]) + 0.5, np.arange(self._own[1]) + 0.5)
            K = optics.K
            v = (y - K[1, 2]) / K[1, 1]
            u = (x - K[0, 2] - K[0, 1] * v) / K[0, 0]
            u, v, inside = distort(u, v, optics.distortion, "opencv")
            pixels = np.stack([u, v], -1) @ K[:2, :2].T + K[:2, 2] - 0.5
            self._map = np.where(np.asarray(inside)[..., None], pixels, -1e4).astype(np.float32)

    def __call__(self, picture: np.ndarray) -> np.ndarray:
        """A picture without its lens, uint8 [h, w, …]."""
        if self._map is not None:
            picture = cv2.remap(picture, self._map[..., 0], self._map[..., 1], cv2.INTER_LINEAR)
        if self.size != self._own:
            picture = cv2.resize(picture, self.size, interpolation=cv2.INTER_AREA)
        return picture


def take_film(
    recording: Recording,
    view: str,
    columns: JointNumbers,
    optics: Optics,
    episodes: Sequence[int],
    most: int,
    masks: MaskTable | None = None,
) -> Film:
    """Pictures of some episodes.

    Args:
        recording: The dataset.
        view: The camera's name.
        columns: Which numbers of the state are joints.
        optics: How the camera sees.
        episodes: Their numbers, ascending; the view saw them.
        most: Pictures of each.
        masks: Where the arm is, if another tool says it: then only pictures with masks are taken.

    Raises:
        DatasetError: Pictures cannot be decoded, or numbers are no joint angles.
    """
    straight = Straightener(optics)
    rgb, angles, speeds, opening, numbers, steps, shapes = [], [], [], [], [], [], []
    for number in episodes:
        check_stop()
        episode = recording.episodes[number]
        joints, opened = joints_of(episode, columns)
        wanted = chosen_steps(joints, most)
        if masks is not None:
            wanted = np.array(sorted(t for e, t in masks if e == number and t < len(joints)), int)
        speed = np.gradient(joints, axis=0) * recording.rate if len(joints) > 1 else 0 * joints
        for step, picture in _decoded(episode.sights[view], wanted, episode.name):
            rgb.append(straight(picture))
            angles.append(joints[step])
            speeds.append(speed[step])
            opening.append(opened[step] if opened is not None else 0)
            numbers.append(number)
            steps.append(step)
            if masks is not None:
                shapes.append(straight(_fitting(masks[number, step], optics)) > 127)
    if not rgb:
        raise DatasetError(f"View '{view}': no picture of episodes {list(episodes)[:8]}.")
    return Film(
        straight.K, np.stack(rgb), np.stack(angles), np.stack(speeds),
        np.array(opening) if columns.opening is not None else None,
        np.array(numbers), np.array(steps), np.stack(shapes) if shapes else None,
    )  # fmt: skip


def _decoded(sight: Sight, wanted: np.ndarray, name: str) -> list[tuple[int, np.ndarray]]:
    steps, pairs = set(wanted.tolist()), []
    for step, picture in enumerate(sight.decode()):
        if step in steps:
            if picture.shape[:2] != (sight.height, sight.width):
                raise DatasetError(
                    f"Episode '{name}', step {step}: a picture of {picture.shape[1]}x"
                    f"{picture.shape[0]}, expected {sight.width}x{sight.height}."
                )
            pairs.append((step, picture.copy()))
    return pairs


def _fitting(mask: np.ndarray, optics: Optics) -> np.ndarray:
    mask = mask.astype(np.uint8) * 255
    return cv2.resize(mask, (optics.width, optics.height), interpolation=cv2.INTER_LINEAR)


def read_masks(path: Path) -> MaskTable:
    """Masks of another tool.

    Args:
        path: An .npz with `episode` int [n], `step` int [n] and `mask` bool [n, H, W], which is
            true where the arm's moving links are.

    Raises:
        ConfigError: There is no such file, or it holds something else.
    """
    import io

    expected = "Expected an .npz with episode [n], step [n] and mask [n, H, W]."
    if not path.is_file():
        raise ConfigError(f"--masks {path}: no such file. {expected}")
    try:
        with np.load(io.BytesIO(read_bytes(path, MASKS)), allow_pickle=False) as file:
            episode, step, mask = (np.asarray(file[n]) for n in ("episode", "step", "mask"))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"--masks {path}: cannot be read: {error}. {expected}") from error
    if not (episode.ndim == step.ndim == 1 and mask.ndim == 3
            and len(episode) == len(step) == len(mask)):  # fmt: skip
        shapes = f"{episode.shape}, {step.shape} and {mask.shape}"
        raise ConfigError(f"--masks {path}: arrays of shapes {shapes}. {expected}")
    keys = zip(episode.tolist(), step.tolist(), strict=True)
    return {(int(e), int(t)): m > 0 for (e, t), m in zip(keys, mask, strict=True)}
