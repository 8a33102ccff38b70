"""What a demonstration file says of itself, and its cameras, whose intrinsics may differ."""
# K is K.
# pyright: reportConstantRedefinition=false

import typing
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, cast

import numpy as np

from jaxcam.config.conditions import (
    ASPECT,
    CENTRE,
    FOVY,
    OPTICS,
    Conditions,
    lens_spans,
    of_task,
    span,
)
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.rays import Camera
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.rays.lens import PACKED, Lens, check_distortion
from jaxcam.rays.optics import OpticsRanges, at_size

FORMAT = 1
CAMERA_ARRAYS: Mapping[str, tuple[int, ...]] = {"K": (3, 3), "distortion": (PACKED,)}
"""Names and shapes of the arrays in `cameras` that a file has whose cameras differ in these."""


@dataclass(frozen=True)
class Header:
    """What a file says of itself."""

    task: str
    scene: str
    n: int
    m: int
    seed: int
    train: int
    """Training demonstrations that the complete file has."""
    valid: int
    """Validation demonstrations that the complete file has."""
    fovy_deg: float
    """Vertical field of view of all cameras, unless `K` says each one's."""
    nq: int
    nv: int
    world_from_camera: np.ndarray = field(repr=False)
    """All cameras [N, 4, 4]: the schedule's, then one held-out camera per validation demo."""
    versions: dict[str, str] = field(default_factory=dict)
    format: int = FORMAT
    optics: dict[str, str] = field(default_factory=dict)
    """The settings that the cameras' intrinsics were drawn from, where they differ, as they were
    written; `ranges` has them as settings are kept."""
    K: np.ndarray | None = field(default=None, repr=False)
    """Of square pictures of height 1, of all cameras [N, 3, 3]; None where all are alike."""
    distortion: np.ndarray | None = field(default=None, repr=False)
    """Their lenses, packed [N, 9]; None where all are pinholes."""

    def identity(self) -> dict[str, Any]:
        """What two files must share to be parts of one dataset."""
        names = [f.name for f in fields(self)]
        arrays = ("world_from_camera", "versions", *CAMERA_ARRAYS)
        values = {k: getattr(self, k) for k in names if k not in arrays}
        return values if self.optics else {k: v for k, v in values.items() if k != "optics"}

    def intrinsics(self, height: int, width: int | None = None) -> np.ndarray:
        """K of all cameras in pixels of pictures of a size, float64 [N, 3, 3].

        Args:
            height: Rows of the pictures.
            width: Columns of them; as many as rows when None.
        """
        if self.K is not None:
            return at_size(self.K, height, width)
        K = intrinsics(self.fovy_deg, height, width)
        return np.broadcast_to(K, (len(self.world_from_camera), 3, 3))

    def camera(self, rows: Any, height: int, width: int | None = None) -> Camera:
        """Some of the cameras in the world, with their own intrinsics and lenses.

        Args:
            rows: One number, or several [...].
            height: Rows of their pictures.
            width: Columns of them; as many as rows when None.
        """
        lens = None if self.distortion is None else self.distortion[rows]
        K, poses = self.intrinsics(height, width)[rows], self.world_from_camera[rows]
        return Camera(K, poses, height, width or height, lens)

    @property
    def ranges(self) -> dict[str, str]:
        """`optics` in the one form of settings, so that texts of one meaning are one."""
        return said_optics(of_task(Conditions(**self.optics), self.fovy_deg))

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Those of the cameras by their names in `cameras`."""
        own = {name: getattr(self, name) for name in CAMERA_ARRAYS}
        there = {name: array for name, array in own.items() if array is not None}
        return {"world_from_camera": self.world_from_camera, **there}


def read_camera_arrays(
    path: Path, group: Any, cameras: int, optics: Mapping[str, str]
) -> dict[str, np.ndarray]:
    """Intrinsics and lenses of a file's cameras, where they differ.

    Args:
        path: Of the file, for messages.
        group: Arrays by name, such as the file's group `cameras`.
        cameras: How many there are.
        optics: The settings that they were drawn from, as the header says.

    Raises:
        DatasetError: There are other numbers of them, or the header speaks of what is not there.
        CameraError: One of them cannot be.
    """
    _check_said(path, group, cameras, optics)
    arrays: dict[str, np.ndarray] = {}
    for name, shape in CAMERA_ARRAYS.items():
        if name not in group:
            continue
        array = np.asarray(group[name][()])
        if array.shape != (cameras, *shape) or array.dtype.kind != "f":
            raise DatasetError(
                f"{path}: cameras/{name} is {array.dtype} {list(array.shape)}, expected "
                f"floating-point numbers {[cameras, *shape]}."
            )
        arrays[name] = array
    if "distortion" in arrays:
        check_distortion(arrays["distortion"], "opencv", f"{path}: cameras/distortion")
    if "K" in arrays:
        side = 64  # of a picture as large as cameras are checked for
        still = np.broadcast_to(np.eye(4), (cameras, 4, 4))
        K, lens = at_size(arrays["K"], side), arrays.get("distortion")
        Camera(K, still, side, side, lens).validate(f"{path}: cameras/K")
    return arrays


def _check_said(path: Path, group: Any, cameras: int, optics: Mapping[str, str]) -> None:
    """Refuses ranges that cannot be, and those of arrays that a file has not."""
    if unknown := [name for name in optics if name not in OPTICS]:
        raise DatasetError(
            f"{path}: header: optics has {unknown[0]!r:.80}, expected names among "
            f"{', '.join(OPTICS)}."
        )
    try:
        wanted = {"K": "", "distortion": Conditions(**optics).lens} if optics else {}
    except ConfigError as error:
        raise DatasetError(f"{path}: header: optics: {error}") from error
    for name, lens in wanted.items():
        if name not in group and (lens or name == "K"):
            said = ", ".join(f"{k} {v}" for k, v in optics.items())
            raise DatasetError(
                f"{path}: cameras/{name} is missing, but by the header the cameras were drawn "
                f"from {said}. Expected {[cameras, *CAMERA_ARRAYS[name]]} numbers, got none "
                f"(cameras has {', '.join(sorted(group))}). Copy the file anew or collect it "
                'again; if its cameras are alike, take "optics" out of its header.'
            )


def optics_ranges(settings: Any, fovy_deg: float) -> OpticsRanges | None:
    """The intrinsics that settings let cameras have; None where they all have the task's.

    Args:
        settings: With the names in `OPTICS`.
        fovy_deg: Field of view of the task's cameras.
    """
    if not any(getattr(settings, name) for name in OPTICS):
        return None
    model, coefficients = lens_spans(settings.lens) or ("opencv", ())
    known: tuple[str, ...] = typing.get_args(Lens)
    assert model in known
    return OpticsRanges(
        fovy_deg=span(settings.fovy, "fovy", FOVY) or (fovy_deg, fovy_deg),
        aspect=span(settings.aspect, "aspect", ASPECT) or (1.0, 1.0),
        centre=span(settings.centre, "centre", CENTRE) or (0.0, 0.0),
        lens=cast(Lens, model),
        coefficients=coefficients,
    )


def said_optics(settings: Any) -> dict[str, str]:
    """The settings of cameras' intrinsics that are not the task's, by name.

    Args:
        settings: With the names in `OPTICS`.
    """
    return {name: value for name in OPTICS if (value := getattr(settings, name))}
