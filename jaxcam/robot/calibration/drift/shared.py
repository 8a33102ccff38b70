"""Faults of the joints that all episodes share, though each may have its camera elsewhere.

One episode hardly tells a joint that is off from a camera that stands elsewhere. Most cameras stand
still, so poses are tied to each other: by a Student distribution, whose tails let go of those
that moved. What remains is linear, and episodes are eliminated one by one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxcam.robot.calibration.arm.refine import JOINT, LAG, Equations, Refiner, Solution
from jaxcam.robot.calibration.projection import change_of, moved

TIE = np.repeat([1 / 0.0015**2, 1 / np.deg2rad(0.07) ** 2], 3)
"""Of a still camera's poses, as single episodes tell them: one over squared deviations (m, rad)."""
ROUNDS = 12
"""In which each pose's tie is weighed anew."""
FREEDOM = 1.0
"""Degrees of freedom of the Student distribution of poses."""


@dataclass(frozen=True)
class Shared:
    """What all episodes have in common."""

    joints: np.ndarray
    """What is to be added to the joints' angles (rad), [joints]."""
    lag: float
    """Time (s) by which pictures are later than states."""


def shared_faults(
    refiners: Sequence[Refiner],
    given: Sequence[np.ndarray],
    starts: Sequence[np.ndarray],
    reaches: Sequence[float],
) -> Shared:
    """Faults of joints and clock.

    Args:
        refiners: One an episode.
        given: Poses that are given, [4, 4].
        starts: Poses from which on is looked, [4, 4].
        reaches: Pixels within which edges are looked for, of a picture 256 high; one a round.
    """
    poses, faults = list(starts), np.zeros(refiners[0].arm.joints + 1)
    for reach in reaches:
        equations = [
            refiner.equations(Solution(pose, faults[:-1], faults[-1]), reach * refiner.scale)
            for refiner, pose in zip(refiners, poses, strict=True)
        ]
        changes = np.stack([change_of(a, b) for a, b in zip(given, poses, strict=True)])
        steps, more = solve_shared(equations, changes, faults)
        poses = [moved(pose, step) for pose, step in zip(poses, steps, strict=True)]
        faults = faults + more
    return Shared(faults[:-1], float(faults[-1]))


def solve_shared(
    equations: Sequence[Equations], changes: np.ndarray, faults: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Solves what all episodes ask for, each in its own pose and in faults that are everyone's.

    Args:
        equations: Of each episode.
        changes: Of the poses, from those that are given to those near which was looked, [n, 6].
        faults: Of joints and clock, likewise, [joints + 1].

    Returns:
        Steps of the poses, [n, 6], and of the faults.
    """
    normals, pulls = (
        np.stack([getattr(e, name) for e in equations]) for name in ("normal", "pull")
    )
    held = np.r_[np.full(len(faults) - 1, 1 / JOINT**2), 1 / LAG**2]
    weights, steps, shared = np.ones(len(equations)), changes * 0, np.zeros(6 + len(faults))
    for _ in range(ROUNDS):
        ties = weights[:, None, None] * np.diag(TIE)
        own = np.linalg.inv(normals[:, :6, :6] + ties)
        across = np.concatenate([-ties, normals[:, :6, 6:]], -1)
        both = np.zeros((len(equations), len(shared), len(shared)))
        both[:, :6, :6], both[:, 6:, 6:] = ties, normals[:, 6:, 6:]
        tied = (ties @ changes[..., None])[..., 0]
        alone = pulls[:, :6] - tied
        least = (both - across.swapaxes(1, 2) @ own @ across).sum(0)
        least += np.diag(np.r_[np.full(6, 1e-6), held])
        right = np.concatenate([tied, pulls[:, 6:]], -1)
        right = (right - np.einsum("nis,nij,nj->ns", across, own, alone)).sum(0)
        shared = np.linalg.solve(least, right - np.r_[np.zeros(6), held * faults])
        steps = np.einsum("nij,nj->ni", own, alone - across @ shared)
        far = ((changes + steps - shared[:6]) ** 2 * TIE).sum(-1)
        weights = (FREEDOM + 6) / (FREEDOM + far)
    return steps, shared[6:]
