"""Recorded demonstrations: what a robot did, and what cameras saw of it, as somebody kept it.

A reader of a format (`jaxcam.interop`) makes these records, and nothing after it knows the format.
Numbers are in memory, pictures are where they were recorded until they are decoded into a cache.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from jaxcam.config.names import ActionMeaning


@dataclass(frozen=True)
class Calibration:
    """Where a camera stood while an episode was recorded, and how it saw.

    What has a first axis T holds picture by picture, as on a wrist; the rest holds throughout.
    """

    K: np.ndarray
    """Intrinsics in pixels of the recorded pictures, float64 [3, 3] or [T, 3, 3]."""
    base_from_camera: np.ndarray
    """Poses in the robot's base frame, OpenCV axes, float64 [4, 4] or [T, 4, 4]."""
    distortion: np.ndarray = field(default_factory=lambda: np.zeros(9))
    """The lens, of either model, as `jaxcam.rays.lens.pack` gives it, float64 [9]."""
    source: str = ""
    """Where the numbers are from, in words."""


@dataclass(frozen=True)
class Placement:
    """What a dataset's own format says of a camera, which calibrations from elsewhere overrule.

    The pose or K may be missing. What has a first axis T holds picture by picture, as on a wrist.
    """

    base_from_camera: np.ndarray | None
    """Poses in the robot's base frame, OpenCV axes, float64 [4, 4] or [T, 4, 4]."""
    source: str
    """Where the pose is from, in words."""
    K: np.ndarray | None = None
    """Intrinsics in pixels of the recorded pictures, float64 [3, 3]."""
    K_source: str = ""
    """Where they are from, in words."""
    distortion: np.ndarray | None = None
    """The lens that goes with K, float64 [9]; a pinhole when None."""


@dataclass(frozen=True)
class Sight:
    """What one camera saw of one episode."""

    height: int
    """Rows of a recorded picture."""
    width: int
    """Columns of a recorded picture."""
    decode: Callable[[], Iterator[np.ndarray]] = field(repr=False)
    """Gives the episode's T pictures in order of time, uint8 [height, width, 3], top row first.

    Raises `DatasetError` naming file and episode where it cannot.
    """
    calibration: Calibration | None = None
    """None where nobody says where the camera stood."""
    placement: Placement | None = None
    """What `jaxcam.interop.calibrations` falls back on; None where the format does not say."""


@dataclass(frozen=True)
class Episode:
    """One recorded demonstration of T steps."""

    name: str
    """What its dataset calls it, for messages."""
    state: np.ndarray = field(repr=False)
    """What the robot felt before each action, float32 [T, P]."""
    action: np.ndarray = field(repr=False)
    """What it was told to do, in the dataset's own space, float32 [T, A]."""
    instruction: str
    """What was asked of it, in words; empty where nobody says."""
    sights: Mapping[str, Sight] = field(repr=False)
    """By the view's name; a view that did not see this episode is missing."""
    errors: np.ndarray | None = field(default=None, repr=False)
    """Which actions err on purpose, so that they are not imitated, bool [T]; None where nobody
    says."""

    @property
    def length(self) -> int:
        """Steps T."""
        return len(self.action)


@dataclass(frozen=True)
class Recording:
    """A recorded dataset."""

    path: Path
    """Its folder."""
    views: tuple[str, ...]
    """Names of its cameras."""
    state_names: tuple[str, ...]
    """Names of the P numbers of `Episode.state`."""
    action_names: tuple[str, ...]
    """Names of the A numbers of `Episode.action`."""
    rate: float
    """Steps a second."""
    episodes: Sequence[Episode] = field(repr=False)
    fingerprint: str
    """Hash of all that training sees of it: numbers, calibrations, and which pictures."""
    valid: tuple[int, ...] = ()
    """Numbers of the episodes that the dataset itself holds out, if it says so."""
    action_is: ActionMeaning = "unknown"
    """What its actions are, if it says so."""
    pictures: str = ""
    """Hash of which pictures those are, whatever the calibrations; empty where a reader does not
    tell them apart."""

    @property
    def instructions(self) -> tuple[str, ...]:
        """What was asked in its episodes, each once, in order of appearance."""
        return tuple(dict.fromkeys(episode.instruction for episode in self.episodes))

    @property
    def pictures_fingerprint(self) -> str:
        """What changes when decoded pictures are no longer those of this dataset."""
        return self.pictures or self.fingerprint
