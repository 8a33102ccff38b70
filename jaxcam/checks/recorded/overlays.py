"""What recorded cameras see, with the grip's way and the base's axes where their numbers are."""

from collections.abc import Sequence

import cv2
import numpy as np

from jaxcam.checks.overlays import (
    GRIP_LENGTH,
    PATH,
    PIXELS,
    TABLE_LENGTH,
    chosen,
    draw_axes,
    draw_line,
    sheet,
)
from jaxcam.checks.recorded.judged import called
from jaxcam.checks.recorded.looks import Look, Looks
from jaxcam.data.recorded.recording import Sight
from jaxcam.rays import Camera


def draw_looks(
    looks: Looks, episodes: Sequence[int], grip: Sequence[int] | None, count: int
) -> np.ndarray | None:
    """Pictures of each view in some episodes, drawn over, as a sheet; None if there are none.

    Args:
        looks: The pictures.
        episodes: Those that were looked at.
        grip: Columns of the state that are the grip's position, if they are known.
        count: Episodes that are shown, of each view.
    """
    pictures, captions = [], []
    for view in looks.recording.views:
        rows = [e for e in episodes if looks.at(e, view) is not None]
        for e in [rows[i] for i in chosen(len(rows), count)] if rows else []:
            look, episode = looks.at(e, view), looks.recording.episodes[e]
            assert look is not None
            places = None if grip is None else episode.state[:, list(grip)].astype(float)
            pictures.append(_drawn(look, episode.sights[view], places))
            captions.append(f"{view}  {called(episode)}  step {look.middle}")
    return sheet(pictures, captions) if pictures else None


def _drawn(look: Look, sight: Sight, places: np.ndarray | None) -> np.ndarray:
    """One picture within a square, drawn over."""
    scale = PIXELS / max(sight.height, sight.width)
    size = max(1, round(sight.width * scale)), max(1, round(sight.height * scale))
    picture = cv2.resize(look.colour, size, interpolation=cv2.INTER_AREA)
    t = look.middle
    if sight.calibration is not None and np.isfinite(sight.calibration.K).all():
        K, pose = (_at(x, t) for x in (sight.calibration.K, sight.calibration.base_from_camera))
        K = K * np.array([size[0] / sight.width, size[1] / sight.height, 1])[:, None]
        lens = np.asarray(sight.calibration.distortion, float)
        camera = Camera(K, pose, size[1], size[0], lens)
        draw_axes(picture, camera, np.eye(4), TABLE_LENGTH)
        if places is not None:
            draw_line(picture, camera, places, PATH, 1)
            there = np.eye(4)
            there[:3, 3] = places[t]
            draw_axes(picture, camera, there, GRIP_LENGTH)
    square = np.zeros((PIXELS, PIXELS, 3), np.uint8)
    square[: size[1], : size[0]] = picture
    return square


def _at(values: np.ndarray, t: int) -> np.ndarray:
    values = np.asarray(values, float)
    return values[t] if values.ndim == 3 else values
