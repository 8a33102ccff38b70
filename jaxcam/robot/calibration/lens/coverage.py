"""Which views of a board are there, and which are missing."""

from collections.abc import Sequence

import numpy as np

from jaxcam.robot.calibration.boards import BoardSeen

CELLS = (4, 5)
"""Rows and columns of the parts of a picture that should each have seen corners."""
ENOUGH = 4
"""Corners that such a part should have seen, in all pictures together."""
TILTED = np.deg2rad(15)
"""From when on a board counts as tilted."""


def covered(views: Sequence[BoardSeen], size: tuple[int, int]) -> np.ndarray:
    """Corners in each part of the picture, int `CELLS`.

    Args:
        views: What was seen.
        size: Width and height of the pictures.
    """
    pixels = np.concatenate([view.pixels for view in views])
    row = np.clip(pixels[:, 1] * CELLS[0] / size[1], 0, CELLS[0] - 1).astype(int)
    column = np.clip(pixels[:, 0] * CELLS[1] / size[0], 0, CELLS[1] - 1).astype(int)
    counts = np.zeros(CELLS, int)
    np.add.at(counts, (row, column), 1)
    return counts


def missing_places(views: Sequence[BoardSeen], size: tuple[int, int]) -> list[str]:
    """Parts of the picture without corners, in words such as "the upper left"."""
    low = covered(views, size) < ENOUGH
    rows, columns = CELLS
    places = []
    for v, row in (("upper", low[0]), ("lower", low[-1])):
        places += [f"the {v} left corner"] if row[0] else []
        places += [f"the {v} right corner"] if row[-1] else []
        places += [f"the {v} edge"] if row[1:-1].all() else []
    for h, column in (("left", low[:, 0]), ("right", low[:, -1])):
        places += [f"the {h} edge"] if column[1:-1].all() else []
    middle = low[1 : rows - 1, 1 : columns - 1]
    return places + (["the middle"] if middle.all() else [])


def tilts(boards: np.ndarray) -> np.ndarray:
    """How boards are tilted away from the camera: about its y and its x, [n, 2] (rad).

    Args:
        boards: Their poses in the camera's axes, [n, 4, 4]; z into the board.
    """
    # Against the direction in which each is seen.
    sight = boards[:, :3, 3] / np.linalg.norm(boards[:, :3, 3], axis=-1, keepdims=True)
    normal = boards[:, :3, 2]
    across = normal - sight * (normal * sight).sum(-1, keepdims=True)
    angle = np.arcsin(np.clip(np.linalg.norm(across, axis=-1), 0, 1))
    direction = across[:, :2] / np.maximum(np.linalg.norm(across[:, :2], axis=-1), 1e-9)[:, None]
    return angle[:, None] * direction


def missing_tilts(boards: np.ndarray) -> list[str]:
    """Which tilts are missing, in words."""
    tilt = tilts(boards)
    sides = {
        "right edge nearer": tilt[:, 0] > TILTED,
        "left edge nearer": tilt[:, 0] < -TILTED,
        "lower edge nearer": tilt[:, 1] > TILTED,
        "upper edge nearer": tilt[:, 1] < -TILTED,
    }
    return [words for words, there in sides.items() if not there.any()]


def most_different(views: Sequence[BoardSeen], points: np.ndarray, most: int) -> list[int]:
    """Numbers of the views that differ most in where and how they show the board, in order.

    Args:
        views: What was seen.
        points: Of the board, [n, 3].
        most: How many at most.
    """
    if len(views) <= most:
        return list(range(len(views)))
    features = np.stack([_shape(view, points) for view in views])
    features /= np.maximum(features.std(0), 1e-9)
    counts = np.array([len(view.ids) for view in views])
    chosen = [int(np.argmax(counts))]
    far = np.linalg.norm(features - features[chosen[0]], axis=-1)
    while len(chosen) < most:
        chosen.append(int(np.argmax(far)))
        far = np.minimum(far, np.linalg.norm(features - features[chosen[-1]], axis=-1))
    return sorted(chosen)


def _shape(view: BoardSeen, points: np.ndarray) -> np.ndarray:
    """Middle, size and affine shape of a board in a picture, [6]."""
    at = np.c_[points[view.ids, :2], np.ones(len(view.ids))]
    affine = np.linalg.lstsq(at, view.pixels, rcond=None)[0]
    return np.concatenate([view.pixels.mean(0), affine[:2].ravel()])
