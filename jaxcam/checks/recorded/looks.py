"""Some pictures of some episodes, small and grey: what the doctor looks at."""

from dataclasses import dataclass, field

import cv2
import numpy as np

from jaxcam.checks.overlays import chosen
from jaxcam.data.recorded.recording import Recording
from jaxcam.errors import DatasetError

PICTURES = 16
"""Pictures of an episode that are looked at, evenly spread."""
SIDE = 192
"""Pixels of their longer side at most."""


@dataclass(frozen=True)
class Look:
    """Some pictures of an episode as one camera saw it."""

    steps: np.ndarray
    """Their steps [n]."""
    grey: np.ndarray = field(repr=False)
    """uint8 [n, h, w]."""
    colour: np.ndarray = field(repr=False)
    """The one in the middle as it was recorded, uint8 [H, W, 3]."""
    scale: float
    """What a recorded picture was scaled by."""

    @property
    def middle(self) -> int:
        """Step of the one in the middle."""
        return int(self.steps[len(self.steps) // 2])


class Looks:
    """The pictures of a recording, decoded when they are first asked for."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.broken: dict[tuple[int, str], str] = {}
        """Why episodes (by number) could not be decoded, by view too."""
        self._looks: dict[tuple[int, str], Look] = {}

    def at(self, episode: int, view: str) -> Look | None:
        """Pictures of an episode; None if the view did not see it or they cannot be decoded."""
        key = episode, view
        if view not in self.recording.episodes[episode].sights or key in self.broken:
            return None
        if key not in self._looks:
            try:
                self._looks[key] = self._look(episode, view)
            except DatasetError as error:
                self.broken[key] = str(error)
                return None
        return self._looks[key]

    def of(self, view: str) -> dict[int, Look]:
        """What has been looked at of a view, by the episode's number, ascending."""
        return {e: look for (e, v), look in sorted(self._looks.items()) if v == view}

    def _look(self, number: int, view: str) -> Look:
        episode = self.recording.episodes[number]
        sight = episode.sights[view]
        steps = chosen(episode.length, PICTURES)
        wanted, middle = set(steps.tolist()), int(steps[len(steps) // 2])
        scale = min(1.0, SIDE / max(sight.height, sight.width))
        grey, colour, count = [], None, 0
        for t, picture in enumerate(sight.decode()):
            if picture.shape != (sight.height, sight.width, 3):
                raise DatasetError(
                    f"picture {t} is {picture.shape}, expected {sight.height} x {sight.width} x 3."
                )
            if t in wanted:
                grey.append(_small(picture, scale))
            colour = picture.copy() if t == middle else colour
            count = t + 1
        if count != episode.length or colour is None:
            raise DatasetError(f"{count} pictures of {episode.length} steps.")
        return Look(steps, np.stack(grey), colour, scale)


def _small(picture: np.ndarray, scale: float) -> np.ndarray:
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    if scale == 1:
        return grey
    size = (max(1, round(grey.shape[1] * scale)), max(1, round(grey.shape[0] * scale)))
    return cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
