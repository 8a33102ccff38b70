"""By how much a camera moved: what each episode's pictures ask for, tested against no change.

From the pose that is given, the arm's contours are put on the edges of one episode's pictures
alone. Faults of the joints ask for a change in all episodes alike, so a change is held against that
of the episodes that agree with each other and lie nearest to the given poses.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from jaxcam.robot.calibration.arm.film import Film
from jaxcam.robot.calibration.arm.model import ArmModel
from jaxcam.robot.calibration.arm.refine import Prior, Refined, Refiner, Solution
from jaxcam.robot.calibration.projection import moved

REACHES = (14.0, 8.0, 5.0)
"""Pixels within which edges are looked for, with the joints free."""
LAST = (5.0, 4.0)
"""Likewise, with the joints as most episodes have them."""
HELD = np.deg2rad(0.02)
"""Standard deviation (rad) that joints then have."""
SUPPORT, NEAR = 0.3, 2.0
"""Share of the contour that must lie on edges within so many pixels."""
FLOOR = 0.0015, np.deg2rad(0.07)
"""Standard deviations (m, rad) that a change has at least."""
LIMIT = 30.0
"""Squared distance, in standard deviations, beyond which a camera has moved. Of six normal numbers
one in 25 000 has 30; those of so few pictures have longer tails."""
LEAST = 0.004, np.deg2rad(0.25)
"""Changes (m, rad) below both of which nothing is said."""
SHARE = 0.25
"""Share of the episodes that must agree to be what others are held against."""
TYPICAL = 5.35
"""Median of the squared length of six normal numbers."""


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


def ask_again(arm: ArmModel, film: Film, asked: AskedChange, joints: np.ndarray) -> AskedChange:
    """The same with the joints as most episodes have them.

    Args:
        arm: The robot.
        film: Of the episode.
        asked: What was asked with the joints free.
        joints: Their faults (rad), [joints].
    """
    refiner = Refiner(arm, film)
    start = Solution(moved(asked.given, asked.change), joints, 0.0)
    refined = refiner.refine(start, LAST, Prior(joints, joint_sigma=HELD))
    return _asked(refiner, refined, asked.given, film)


def _asked(refiner: Refiner, refined: Refined, given: np.ndarray, film: Film) -> AskedChange:
    pose = np.linalg.inv(given) @ refined.solution.base_from_camera
    change = np.r_[pose[:3, 3], Rotation.from_matrix(pose[:3, :3]).as_rotvec()]
    return AskedChange(
        int(film.episodes[0]), given, change, refined.covariance,
        refined.support(NEAR * refiner.scale), refined.solution.joints,
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
    clear = [a.joints for a in first if a.clear] or [np.zeros(arm.joints)]
    joints = np.median(clear, 0)
    return [
        ask_again(arm, film, a, joints) if a.clear else a
        for film, a in zip(films, first, strict=True)
    ]


def judged_changes(asked: Sequence[AskedChange]) -> list[Tested]:
    """Which episodes had the camera elsewhere.

    Args:
        asked: What episodes ask for; those whose pictures say nothing are left out of the answer.
    """
    clear = [a for a in asked if a.clear]
    if not clear:
        return []
    changes = np.stack([a.change for a in clear])
    floor = np.diag(np.square(np.repeat(FLOOR, 3)))
    spreads = np.stack([a.covariance for a in clear]) + floor
    agree = _distances(changes[:, None] - changes[None], spreads[:, None] + spreads[None]) < LIMIT
    # Of the groups that are large enough, that which is nearest to no change at all.
    large = agree.sum(1) >= max(SHARE * len(clear), min(2, len(clear)))
    sizes = _sizes(changes)
    candidates = np.flatnonzero(large) if large.any() else np.arange(len(clear))
    nearest = candidates[np.argmin(sizes[candidates])]
    group = np.flatnonzero(agree[nearest])
    weights = np.linalg.inv(spreads[group])
    common = np.linalg.solve(weights.sum(0), np.einsum("nij,nj->i", weights, changes[group]))
    own = _distances(changes[group] - common, spreads[group])
    scale = max(1.0, float(np.median(own)) / TYPICAL) if len(group) > 3 else 1.0
    rest = changes - common
    distances = _distances(rest, scale * spreads)
    far = (np.linalg.norm(rest[:, :3], axis=-1) > LEAST[0]) | (
        np.linalg.norm(rest[:, 3:], axis=-1) > LEAST[1]
    )
    return [
        Tested(a, change, float(d), bool(f and d > LIMIT))
        for a, change, d, f in zip(clear, rest, distances, far, strict=True)
    ]


def runs_of(episodes: Sequence[Tested]) -> list[list[Tested]]:
    """Episodes in a row in which a camera had moved, and had moved alike."""
    runs: list[list[Tested]] = []
    before: Tested | None = None
    floor = np.diag(np.square(np.repeat(FLOOR, 3)))
    for one in episodes:
        if one.moved:
            alike = before is not None and before.moved and _distances(
                (one.change - before.change)[None],
                (one.asked.covariance + before.asked.covariance + 2 * floor)[None],
            )[0] < 2 * LIMIT  # fmt: skip
            if alike:
                runs[-1].append(one)
            else:
                runs.append([one])
        before = one
    return [_averaged(run) for run in runs]


def _averaged(run: list[Tested]) -> list[Tested]:
    """Episodes of one place, each with the change that all of them ask for."""
    floor = np.diag(np.square(np.repeat(FLOOR, 3)))
    weights = np.linalg.inv(np.stack([one.asked.covariance + floor for one in run]))
    changes = np.stack([one.change for one in run])
    mean = np.linalg.solve(weights.sum(0), np.einsum("nij,nj->i", weights, changes))
    return [replace(one, change=mean) for one in run]


def _sizes(changes: np.ndarray) -> np.ndarray:
    """How large changes [n, 6] are, a centimetre being as much as a degree, [n]."""
    return np.hypot(
        np.linalg.norm(changes[:, :3], axis=-1) / 0.01,
        np.linalg.norm(changes[:, 3:], axis=-1) / np.deg2rad(1),
    )


def _distances(changes: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """Squared lengths [...] of changes [..., 6] in standard deviations."""
    return np.einsum(
        "...i,...i->...", changes, np.linalg.solve(covariances, changes[..., None])[..., 0]
    )
