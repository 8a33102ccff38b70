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
    lens_spans,
    span,
)
from jaxcam.errors import DatasetError
from jaxcam.rays import Camera
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.rays.lens import PACKED, Lens
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
    """The settings that the cameras' intrinsics were drawn from, where they differ."""
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

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Those of the cameras by their names in `cameras`."""
        own = {name: getattr(self, name) for name in CAMERA_ARRAYS}
        there = {name: array for name, array in own.items() if array is not None}
        return {"world_from_camera": self.world_from_camera, **there}


def read_camera_arrays(path: Path, group: Any, cameras: int) -> dict[str, np.ndarray]:
    """Intrinsics and lenses of a file's cameras, where they differ.

    Args:
        path: Of the file, for messages.
        group: Arrays by name, such as the file's group `cameras`.
        cameras: How many there are.

    Raises:
        DatasetError: There are other numbers of them.
        CameraError: One of them cannot be.
    """
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
    if "K" in arrays:
        side = 64  # of a picture as large as cameras are checked for
        still = np.broadcast_to(np.eye(4), (cameras, 4, 4))
        K, lens = at_size(arrays["K"], side), arrays.get("distortion")
        Camera(K, still, side, side, lens).validate(f"{path}: cameras/K")
    return arrays


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
