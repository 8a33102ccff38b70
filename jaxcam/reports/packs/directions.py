"""Success by the direction that a policy was looked at from, as a small map of coloured cells."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.colors import to_hex

from jaxcam.reports.camera_figures import angle_ticks, rate_by_camera
from jaxcam.reports.style import RATE
from jaxcam.results.rows import Row
from jaxcam.results.stats import wilson

_STEP = 11
"""From a cell to the next one, of which one is a gap, in the units of a map."""
_APART = 3
"""Between the map and its margins."""


@dataclass(frozen=True)
class Cell:
    """Cameras of one range of azimuth, of elevation, or of both.

    Attributes:
        x: Of its left end, in the units of the map.
        y: Of its upper end.
        colour: Of its success rate, such as "#0072b2".
        words: What it is, with its interval.
    """

    x: int
    y: int
    colour: str
    words: str


@dataclass(frozen=True)
class DirectionMap:
    """Cells by azimuth (to the right) and elevation (up), the margins above and at the right.

    Attributes:
        width: In its own units.
        height: In its own units.
        cells: Those with cameras.
        words: The margins as a text.
    """

    width: int
    height: int
    cells: tuple[Cell, ...]
    words: str


def direction_maps(arms: Sequence[Sequence[Row]]) -> list[DirectionMap | None]:
    """A map for the rows of each arm, all with the same ranges; None where no angles are known.

    Args:
        arms: The rows of each.
    """
    cameras = [rate_by_camera(rows) for rows in arms]
    across, up = angle_ticks(np.concatenate([np.zeros((0, 4)), *cameras]))
    return [_map(some, across, up) if len(some) else None for some in cameras]


def _map(cameras: np.ndarray, across: np.ndarray, up: np.ndarray) -> DirectionMap:
    azimuth, elevation, rate, _ = cameras.T
    column, row = _bins(azimuth, across), _bins(elevation, up)
    columns, rows = len(across) - 1, len(up) - 1
    right = columns * _STEP + _APART
    cells = list[Cell]()
    for i in range(columns):
        words = f"azimuth {_range(across, i)}"
        cells += _cell(i * _STEP, 0, words, rate[column == i])
    for k in range(rows):
        y = (rows - k) * _STEP + _APART
        words = f"elevation {_range(up, k)}"
        margin = _cell(right, y, words, rate[row == k])
        for i in range(columns):
            both = f"azimuth {_range(across, i)}, {words}"
            cells += _cell(i * _STEP, y, both, rate[(column == i) & (row == k)])
        cells += margin
    margins = "; ".join(cell.words for cell in cells if not cell.y or cell.x == right)
    size = (right + _STEP - 1, (rows + 1) * _STEP + _APART - 1)
    return DirectionMap(*size, tuple(cells), margins)


def _cell(x: int, y: int, words: str, rates: np.ndarray) -> list[Cell]:
    """A cell; none without cameras. Rollouts on one camera count as one trial."""
    n = len(rates)
    if not n:
        return []
    low, high = wilson(float(rates.sum()), n)
    value = float(rates.mean())
    cameras = "camera" if n == 1 else "cameras"
    interval = f"{100 * value:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"
    return [Cell(x, y, to_hex(RATE(value)), f"{words}: {interval} on {n} {cameras}")]


def _bins(angles: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Which range each angle is in; the last one has its upper end too."""
    return np.clip(np.digitize(angles, edges) - 1, 0, len(edges) - 2)


def _range(edges: np.ndarray, i: int) -> str:
    return f"{edges[i]:.0f}° to {edges[i + 1]:.0f}°"
