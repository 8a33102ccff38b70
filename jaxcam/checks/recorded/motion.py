"""Whether pictures move where the grip is said to move.

Between two pictures of a camera that stands still, what changes is the robot and what it carries.
By the state and the camera's pose, the grip is at one place of the picture before and at another
after; both must be among the places that change most. A pose of another camera or of another base
puts the grip where nothing moves.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from jaxcam.checks.recorded.looks import Look, Looks
from jaxcam.data.recorded.recording import Calibration, Sight
from jaxcam.rays import Camera

BLUR, WIDE = 0.02, 0.1
"""Widths, in pictures, over which motion is smoothed: to judge poses, and to look for others."""
CALM = 1.0
"""Levels of change below which a pixel stands still."""
LOCAL = 4.0
"""How many times the usual change of a picture the largest must be for it to have a place."""
STEP = 0.01
"""Distance (m) that the grip must move between two pictures for them to count."""
LEAST = 6
"""Pairs of pictures below which nothing is said."""
CHANCE = 0.5
"""What a place that is not in the picture counts as: as many places move less as move more."""
FITS = 0.8
"""Share of the picture that must move less than where the grip is. Right poses of our renderings
have 0.9 and more, those of other cameras 0.8 and less."""
MISFITS = 0.7
"""Share below which poses must be mended."""


@dataclass(frozen=True)
class Motion:
    """How an episode moves in a view."""

    rank: np.ndarray
    """Share of the picture that moves less than each pixel, between two pictures, float16
    [n - 1, h, w]."""
    around: np.ndarray
    """The same of motion in a wide neighbourhood of each."""
    places: np.ndarray
    """The grip at each picture, in the base frame (m) [n, 3]."""
    counts: np.ndarray
    """Which pairs of pictures count: the grip moves, and the pictures change in places [n - 1]."""
    scale: float
    """What recorded pictures were scaled by."""

    def fit(self, calibration: Calibration, places: np.ndarray | None = None) -> np.ndarray:
        """How well a camera that stands still puts the grip where pictures move.

        Args:
            calibration: Of pictures of the recorded size.
            places: Where the grip is said to be instead [..., n, 3].

        Returns:
            0 to 1, of each pair that counts [..., pairs].
        """
        places = self.places if places is None else places
        height, width = self.rank.shape[1:]
        shrink = np.array([self.scale, self.scale, 1])[:, None]
        K = np.reshape(calibration.K, (-1, 3, 3))[0] * shrink
        pose, lens = (np.asarray(x, float) for x in (calibration.base_from_camera,
                                                     calibration.distortion))  # fmt: skip
        camera = Camera(K, pose, height, width, lens if lens.any() else None)
        pixels, depth = camera.project(places)
        at = np.clip(np.floor(pixels), -1, max(height, width)).astype(int)
        inside = (depth > 0) & (at >= 0).all(-1) & (at[..., 0] < width) & (at[..., 1] < height)
        column, row = np.moveaxis(np.where(inside[..., None], at, 0), -1, 0)
        pair = np.flatnonzero(self.counts)
        ends = [
            np.where(inside[..., t], self.rank[pair, row[..., t], column[..., t]], CHANCE)
            for t in (pair, pair + 1)
        ]
        return np.minimum(*ends).astype(float)


@dataclass(frozen=True)
class Filmed:
    """An episode as a view that stands still saw it."""

    episode: int
    view: str
    sight: Sight
    calibration: Calibration
    motion: Motion


def motion_of(look: Look, places: np.ndarray) -> Motion:
    """How an episode moves in a view.

    Args:
        look: Its pictures, two at least.
        places: The grip at each of its steps, in the base frame (m) [T, 3].
    """
    changes = abs(np.diff(look.grey.astype(np.float32), axis=0))
    smooth, around = (_blurred(changes, width) for width in (BLUR, WIDE))
    usual, most = np.percentile(smooth, [50, 98], axis=(1, 2))
    places = places[look.steps].astype(float)
    goes = np.linalg.norm(np.diff(places, axis=0), axis=-1) >= STEP
    counts = goes & (most > LOCAL * np.maximum(usual, CALM))
    ranks = np.stack([*map(_rank, smooth)])
    ranks = np.where(smooth < CALM, np.minimum(ranks, CHANCE), ranks)
    wide = np.stack([*map(_rank, around)])
    return Motion(ranks.astype(np.float16), wide.astype(np.float16), places, counts, look.scale)


def _blurred(changes: np.ndarray, width: float) -> np.ndarray:
    sigma = width * max(changes.shape[1:])
    return np.stack([cv2.GaussianBlur(change, (0, 0), sigma) for change in changes])


def _rank(change: np.ndarray) -> np.ndarray:
    """Share of a picture that changes less than each pixel."""
    rank = np.empty(change.size, np.float32)
    rank[np.argsort(change, axis=None)] = np.arange(change.size) / change.size
    return rank.reshape(change.shape)


def films_of(
    looks: Looks,
    episodes: Sequence[int],
    grip: Sequence[int],
    unusable: Collection[tuple[int, str]] = (),
) -> list[Filmed]:
    """What cameras that are said to stand still saw of episodes in which the grip moves.

    Args:
        looks: The pictures.
        episodes: Those that are looked at.
        grip: Columns of the state that are the grip's position.
        unusable: Episodes and views whose calibration cannot be used.
    """
    films = []
    for e in episodes:
        episode = looks.recording.episodes[e]
        for view in looks.recording.views:
            look, sight = looks.at(e, view), episode.sights.get(view)
            if look is None or len(look.grey) < 2 or (e, view) in unusable:
                continue
            if sight is None or sight.calibration is None:
                continue
            if sight.calibration.base_from_camera.ndim == 2 and sight.calibration.K.ndim == 2:
                motion = motion_of(look, episode.state[:, list(grip)])
                films.append(Filmed(e, view, sight, sight.calibration, motion))
    return films
