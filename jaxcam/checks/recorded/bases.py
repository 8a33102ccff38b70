"""Which other base poses may be of: one movement of all cameras after which pictures fit the grip.

A movement and a turn about the vertical are looked for with the cross-entropy method (Rubinstein,
1999), from each of the four sides, by how well pictures then fit (`jaxcam.checks.recorded.motion`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxcam.checks.overlays import chosen
from jaxcam.checks.recorded.motion import FITS, Filmed

SPREAD = np.array([0.6, 0.6, 0.6, 0.4])
"""Of the first movements that are tried: x, y, z (m) and the turn (rad)."""
TRIED, BEST, ROUNDS = 160, 16, 12
"""Movements of a round, those that the next is drawn from, and rounds."""
SURE = FITS + 0.06
"""Fit from which a movement is named."""
FILMS = 24
"""Films that are looked at for it."""
GAIN = 0.1
"""By how much it must fit better than the poses as they are."""


@dataclass(frozen=True)
class OtherBase:
    """A movement of all cameras: `base_from_other @ poses` would fit."""

    position: np.ndarray
    """Of the other base in the robot's (m) [3]."""
    yaw_deg: float
    """Its turn about z."""

    @property
    def words(self) -> str:
        """What it means, and what to do."""
        x, y, z = self.position
        return (
            f"poses are of another base, which stands at about ({x:.2f}, {y:.2f}, {z:.2f}) m in "
            f"the robot's and is turned by about {self.yaw_deg:.0f}° (within 0.2 m and 15°); store "
            "base_from_other @ poses"
        )


def other_base(films: Sequence[Filmed]) -> OtherBase | None:
    """The base that poses may be of; None where no other fits much better than the robot's.

    Args:
        films: Episodes as views of at least two names saw them.
    """
    if len({film.view for film in films}) < 2:
        return None
    films = [films[i] for i in chosen(len(films), FILMS)]
    around = [replace(film, motion=replace(film.motion, rank=film.motion.around)) for film in films]
    rng = np.random.default_rng(0)
    best, most = np.zeros(4), -1.0
    for side in range(4):
        middle, spread = np.array([0, 0, 0, side * np.pi / 2]), SPREAD
        for turn in range(ROUNDS):
            tried = middle + spread * rng.standard_normal((TRIED, 4))
            fits = _fits(around if turn < ROUNDS // 2 else films, tried)
            order = np.argsort(-fits)[:BEST]
            middle, spread = tried[order].mean(0), tried[order].std(0) + 1e-3
            if turn >= ROUNDS // 2 and fits[order[0]] > most:
                best, most = tried[order[0]], float(fits[order[0]])
    if most < max(SURE, _fits(films, np.zeros((1, 4)))[0] + GAIN):
        return None
    yaw = np.rad2deg((best[3] + np.pi) % (2 * np.pi) - np.pi)
    return OtherBase(best[:3], float(yaw))


def _fits(films: Sequence[Filmed], movements: np.ndarray) -> np.ndarray:
    """How well cameras fit after each movement [N], the mean over the views."""
    cosine, sine = np.cos(movements[:, 3]), np.sin(movements[:, 3])
    zero, one = np.zeros_like(cosine), np.ones_like(cosine)
    turns = np.stack([cosine, -sine, zero, sine, cosine, zero, zero, zero, one], -1)
    turns = turns.reshape(-1, 1, 3, 3)
    sums: dict[str, list[np.ndarray]] = {}
    for film in films:
        # The grip as the other base has it: the movement undone.
        places = film.motion.places[None] - movements[:, None, :3]
        places = (places[..., None, :] @ turns)[..., 0, :]
        fit = film.motion.fit(film.calibration, places)
        sums.setdefault(film.view, []).append(fit)
    return np.mean([np.concatenate(each, -1).mean(-1) for each in sums.values()], 0)
