"""By how much a camera moved: what each episode's pictures ask for, tested against no change.

From the pose that is given, the arm's contours are put on the edges of one episode's pictures
alone. Faults of the joints ask for a change in all episodes alike, so changes are held against
those of the rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jaxcam.robot.calibration.arm.film import Film
from jaxcam.robot.calibration.arm.model import ArmModel
from jaxcam.robot.calibration.arm.refine import Prior, Refined, Refiner, Solution
from jaxcam.robot.calibration.drift.shared import Shared, shared_faults
from jaxcam.robot.calibration.drift.still import (
    FLOOR,
    LIMIT,
    astray,
    distances,
    doubt,
    limit_of,
    mean,
    stands_out,
    still_episodes,
    swings,
)
from jaxcam.robot.calibration.projection import change_of, moved

REACHES = (14.0, 8.0, 5.0)
"""Pixels within which edges are looked for, with the joints free."""
LAST = (5.0, 4.0)
"""Likewise, with the joints as most episodes have them."""
HELD = np.deg2rad(0.02)
"""Standard deviation (rad) that joints then have."""
HELD_LAG = 0.002
"""Likewise of the lag (s)."""
SHARED = (5.0, 5.0, 4.0)
"""Pixels, as above, with joints and clock as all episodes have them."""
SUPPORT, NEAR = 0.3, 2.0
"""Share of the contour that must lie on edges within so many pixels."""
LOST = 0.03, np.deg2rad(1.5)
"""Changes (m, rad), beside what most ask for, from which on contours may lie on wrong edges."""


@dataclass(frozen=True)
class AskedChange:
    """What one episode's pictures ask for."""

    episode: int
    given: np.ndarray
    """The pose that is given, [4, 4]."""
    change: np.ndarray
    """Of the camera in its own axes, as in `moved`: metres and radians, [6]."""
    covariance: np.ndarray = field(repr=False)
    """[6, 6]."""
    support: float
    """Share of the contour that lies on edges."""
    joints: np.ndarray = field(repr=False)
    """Faults of the joints as this episode has them (rad)."""
    arm_at: np.ndarray = field(repr=False)
    """Where the arm is before the camera, in the mean of its contour (m), [3]."""

    @property
    def clear(self) -> bool:
        """Whether the pictures say anything."""
        return self.support >= SUPPORT


@dataclass(frozen=True)
class Tested:
    """An episode, held against what most agree on."""

    asked: AskedChange
    change: np.ndarray
    """Less what all ask for, [6]."""
    distance: float
    """Squared, in standard deviations."""
    moved: bool
    """Whether the camera had moved."""

    @property
    def sizes(self) -> tuple[float, float]:
        """Distance (m) and angle (rad)."""
        return float(np.linalg.norm(self.change[:3])), float(np.linalg.norm(self.change[3:]))

    @property
    def pose(self) -> np.ndarray:
        """The new pose, [4, 4]."""
        return moved(self.asked.given, self.change)


def ask(arm: ArmModel, film: Film, given: np.ndarray) -> AskedChange:
    """What the pictures of one episode ask for, with the joints free.

    Args:
        arm: The robot.
        film: Of one episode.
        given: The pose that is given, [4, 4].
    """
    refiner = Refiner(arm, film)
    refined = refiner.refine(Solution(given, np.zeros(arm.joints), 0.0), REACHES)
    return _asked(refiner, refined, given, film)


def ask_again(arm: ArmModel, film: Film, asked: AskedChange, shared: Shared) -> AskedChange:
    """The same with the joints as most episodes have them.

    Args:
        arm: The robot.
        film: Of the episode.
        asked: What was asked with the joints free; its change is where is looked.
        shared: The faults of joints and clock that all episodes share.
    """
    refiner = Refiner(arm, film)
    start = Solution(moved(asked.given, asked.change), shared.joints, shared.lag)
    refined = refiner.refine(start, LAST, Prior(shared.joints, shared.lag, HELD, HELD_LAG))
    return _asked(refiner, refined, asked.given, film)


def _asked(refiner: Refiner, refined: Refined, given: np.ndarray, film: Film) -> AskedChange:
    change = change_of(given, refined.solution.base_from_camera)
    return AskedChange(
        int(film.episodes[0]), given, change, refined.covariance,
        refined.support(NEAR * refiner.scale), refined.solution.joints,
        refined.looked.places.mean(0) if len(refined.left) else np.zeros(3),
    )  # fmt: skip


def changes_asked(
    arm: ArmModel, films: Sequence[Film], given: Sequence[np.ndarray]
) -> list[AskedChange]:
    """What each episode's pictures ask for.

    Args:
        arm: The robot.
        films: Of the episodes, one each.
        given: Their poses, [4, 4].
    """
    first = [ask(arm, film, pose) for film, pose in zip(films, given, strict=True)]
    return with_common_joints(arm, films, first)


def with_common_joints(
    arm: ArmModel, films: Sequence[Film], first: Sequence[AskedChange]
) -> list[AskedChange]:
    """What episodes ask for, once they have the joints in common."""
    clear = [(Refiner(arm, film), a) for film, a in zip(films, first, strict=True) if a.clear]
    if not clear:
        return list(first)
    shared = shared_faults(
        [refiner for refiner, _ in clear],
        [a.given for _, a in clear],
        [moved(a.given, a.change) for _, a in clear],
        SHARED,
    )
    asked = [
        ask_again(arm, film, a, shared) if a.clear else a
        for film, a in zip(films, first, strict=True)
    ]
    changes = [a.change for a in asked if a.clear]
    if not changes:
        return asked
    most = np.median(changes, 0)
    return [
        _found_again(arm, film, a, shared, most) if _is_lost(a, most) else a
        for film, a in zip(films, asked, strict=True)
    ]


def _is_lost(asked: AskedChange, most: np.ndarray) -> bool:
    away = asked.change - most
    place, turn = np.linalg.norm(away[:3]), np.linalg.norm(away[3:])
    return not asked.clear or bool(place > LOST[0] or turn > LOST[1])


def _found_again(
    arm: ArmModel, film: Film, asked: AskedChange, shared: Shared, most: np.ndarray
) -> AskedChange:
    """What was asked, or what is from where most stand: the one with more contour on edges."""
    other = ask_again(arm, film, replace(asked, change=most), shared)
    return max(asked, other, key=lambda a: a.support)


def judged_changes(asked: Sequence[AskedChange]) -> list[Tested]:
    """Which episodes had the camera elsewhere.

    Args:
        asked: What episodes ask for; those whose pictures say nothing are left out of the answer.
    """
    clear = [a for a in asked if a.clear]
    if not clear:
        return []
    changes = np.stack([a.change for a in clear])
    spreads = np.stack([a.covariance for a in clear]) + FLOOR
    spreads = spreads * astray(np.array([a.support for a in clear]))[:, None, None]
    spreads = spreads * doubt(changes, spreads)
    wide = spreads + swings(np.stack([a.arm_at for a in clear]))
    still = still_episodes(changes, wide, limit_of(spreads))
    rest = changes - mean(changes[still], wide[still])[0]
    tested = [
        Tested(replace(a, covariance=spread), change, float(far), not stood)
        for a, change, spread, far, stood in zip(
            clear, rest, spreads, distances(rest, wide), still, strict=True
        )
    ]
    # Those between two moves may have stood where most did.
    numbers = {a.episode: row for row, a in enumerate(clear)}
    for run in runs_of(tested):
        own = np.array([numbers[one.asked.episode] for one in run])
        if not stands_out(own, np.flatnonzero(still), changes, wide, limit_of(spreads)):
            for row in own:
                tested[row] = replace(tested[row], moved=False)
    return tested


def runs_of(episodes: Sequence[Tested]) -> list[list[Tested]]:
    """Episodes in a row in which a camera had moved, and had moved alike."""
    runs: list[list[Tested]] = []
    before: Tested | None = None
    for one in episodes:
        if one.moved:
            if before is not None and before.moved and _alike(one, runs[-1]):
                runs[-1].append(one)
            else:
                runs.append([one])
        before = one
    return [_averaged(run) for run in runs]


def _alike(one: Tested, run: list[Tested]) -> bool:
    """Whether an episode asks for what a run asks for together; its last alone may creep along."""
    change, covariance = _together(run)
    apart = distances((one.change - change)[None], (one.asked.covariance + covariance)[None])
    return bool(apart[0] < LIMIT)


def _together(run: list[Tested]) -> tuple[np.ndarray, np.ndarray]:
    return mean(
        np.stack([one.change for one in run]), np.stack([one.asked.covariance for one in run])
    )


def _averaged(run: list[Tested]) -> list[Tested]:
    """Episodes of one place, each with the change that all of them ask for."""
    change, _ = _together(run)
    return [replace(one, change=change) for one in run]
