"""What is looked at of a camera: some pictures of some episodes, the lens undone, with joints."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from jaxcam.interop.cameras.optics import Optics


@dataclass(frozen=True)
class Film:
    """Pictures of one camera that stands still, and the robot's joints in each."""

    K: np.ndarray
    """Of the pictures, whose lens is undone (pixels), [3, 3]."""
    rgb: np.ndarray = field(repr=False)
    """Uint8 [n, h, w, 3]."""
    angles: np.ndarray = field(repr=False)
    """Joint angles (rad), [n, joints]."""
    speeds: np.ndarray = field(repr=False)
    """Their speeds (rad/s), [n, joints]."""
    opening: np.ndarray | None = field(repr=False)
    """Of the gripper, from 0 to 1, [n]; None where nobody says."""
    episodes: np.ndarray = field(repr=False)
    """Numbers of the pictures' episodes, ascending, [n]."""
    steps: np.ndarray = field(repr=False)
    """Their steps, [n]."""
    masks: np.ndarray | None = field(default=None, repr=False)
    """Where the arm is, as another tool has it, bool [n, h, w]."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.rgb.shape[2], self.rgb.shape[1]

    @property
    def optics(self) -> Optics:
        """How the camera sees, its lens undone."""
        return Optics(self.K, *self.size, np.zeros(9))

    def by_episode(self) -> Iterator[np.ndarray]:
        """Numbers of the pictures of each episode."""
        for episode in np.unique(self.episodes):
            yield np.flatnonzero(self.episodes == episode)

    def some(self, keep: np.ndarray) -> "Film":
        """Only some of the pictures."""
        return replace(
            self,
            rgb=self.rgb[keep],
            angles=self.angles[keep],
            speeds=self.speeds[keep],
            opening=None if self.opening is None else self.opening[keep],
            episodes=self.episodes[keep],
            steps=self.steps[keep],
            masks=None if self.masks is None else self.masks[keep],
        )
