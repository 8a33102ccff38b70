"""What numbers are scaled by before a network sees them, and the floors under that.

Data may not vary in a dimension at all, and then there is nothing to divide by. Two answers are
right in two places:

- **Actions** are divided by a small floor. What the network gets wrong about a dimension that
  stands still then shrinks to nothing in raw units, instead of drifting over an episode.
- **Proprioception** that stands still is divided by 1. A small floor would do harm here, since it
  blows up the first value that does differ.

Statistics that came with a policy of LeRobot's have no floors: it was trained on numbers that were
scaled by what they say, and LeRobot's own guard against a division by zero is then ours.
"""

from typing import Any, NamedTuple

import numpy as np

from jaxcam.models.policy import Stats, statistic

STD_FLOOR = 1e-4
"""Least standard deviation, of stored statistics as of actions: that of the paper's authors."""
ORIGINAL_STD_FLOOR = 1e-2
"""Least standard deviation of actions in the original ACT."""
LEROBOT_STD_FLOOR = 1e-8
"""LeRobot adds this to deviations, and takes it for a range of 0."""
RANGE_FLOOR = 1e-6
"""Least half range of actions, which Diffusion Policy divides by."""
STANDS_STILL = 1e-3
"""Proprioception whose deviation or half range is less than this is divided by 1."""


class Scale(NamedTuple):
    """Raw numbers to those that a network sees, and back."""

    middle: np.ndarray
    """What becomes 0, float32 [D]."""
    size: np.ndarray
    """What becomes 1 above the middle, float32 [D]."""
    shift: float = 0.0
    """What the middle becomes; not 0 where that is the low end of a range."""

    def normalised(self, raw: Any) -> Any:
        """Raw numbers [..., D] as a network sees them."""
        scaled = (raw - self.middle) / self.size
        return scaled + self.shift if self.shift else scaled

    def raw(self, normalised: Any) -> Any:
        """A network's numbers [..., D] in raw units."""
        centred = normalised - self.shift if self.shift else normalised
        return centred * self.size + self.middle


def action_deviation(stats: Stats, floor: float = STD_FLOOR, *, floors: bool = True) -> Scale:
    """Actions by mean and standard deviation.

    Args:
        stats: Of the data.
        floor: Least deviation.
        floors: Whether there is one; otherwise deviations are LeRobot's.
    """
    mean, std = _mean_and_std(stats, "action")
    return Scale(mean, np.maximum(std, np.float32(floor)) if floors else _as_lerobot(std))


def proprio_deviation(stats: Stats, *, floors: bool = True) -> Scale:
    """Proprioception by mean and standard deviation; without floors these are LeRobot's."""
    mean, std = _mean_and_std(stats, "proprio")
    return Scale(mean, _one_where_still(std) if floors else _as_lerobot(std))


def keyframe_deviation(stats: Stats) -> Scale:
    """Keyframes by mean and standard deviation, whose floor is that of stored statistics."""
    return Scale(*_mean_and_std(stats, "keyframe"))


def action_range(stats: Stats, *, floors: bool = True) -> Scale:
    """Actions by the middle and half of their range, so that they fill -1 to 1.

    Without floors the range is LeRobot's: one of 0 has all of its values at -1.
    """
    return _middle_and_half(stats, "action") if floors else _from_low_end(stats, "action")


def proprio_range(stats: Stats, *, floors: bool = True) -> Scale:
    """Proprioception by its range, see `action_range`."""
    if not floors:
        return _from_low_end(stats, "proprio")
    middle, half, _ = _middle_and_half(stats, "proprio")
    return Scale(middle, _one_where_still(half))


def _mean_and_std(stats: Stats, name: str) -> tuple[np.ndarray, np.ndarray]:
    return statistic(stats, f"{name}_mean"), statistic(stats, f"{name}_std")


def _middle_and_half(stats: Stats, name: str) -> Scale:
    low, high = _ends(stats, name)
    return Scale((low + high) / 2, np.maximum((high - low) / 2, np.float32(RANGE_FLOOR)))


def _from_low_end(stats: Stats, name: str) -> Scale:
    low, high = _ends(stats, name)
    whole = np.where(high == low, np.float32(LEROBOT_STD_FLOOR), high - low)
    return Scale(low, whole / 2, shift=-1.0)


def _ends(stats: Stats, name: str) -> tuple[np.ndarray, np.ndarray]:
    return statistic(stats, f"{name}_min"), statistic(stats, f"{name}_max")


def _as_lerobot(std: np.ndarray) -> np.ndarray:
    return std + np.float32(LEROBOT_STD_FLOOR)


def _one_where_still(size: np.ndarray) -> np.ndarray:
    return np.where(size < STANDS_STILL, 1, size).astype(np.float32)
