"""Where a camera stands that sees the arm move: search, refinement, and when to refuse."""

from dataclasses import dataclass, field

import numpy as np

from jaxcam.errors import DatasetError
from jaxcam.robot.calibration.arm.film import Film
from jaxcam.robot.calibration.arm.model import ArmModel
from jaxcam.robot.calibration.arm.refine import REACHES, Refined, Refiner, Solution
from jaxcam.robot.calibration.arm.search import FINE, MotionCells, changes_of, search
from jaxcam.robot.calibration.projection import apart

LEAST_MOTION = 0.15
"""Way (rad) between the joints of two pictures that are the farthest apart, which is needed."""
LEAST_CHANGE = 4.0
"""Coarse cells that change at least, in the mean of the pairs of pictures."""
ALIKE = 0.93
"""A pose from elsewhere that is supported so well, against the best, explains it alike."""
ELSEWHERE = 0.1, np.deg2rad(8)
"""How far (m, rad) it then is."""
NEAR = 2.0
"""Pixels within which an edge supports a contour, of a picture 256 high."""
SUPPORT = 0.3
"""Share of the contour that must be supported."""
CLEARLY, RIVAL = 0.5, 0.85
"""A pose with so much support is tried alone, if those from other sides explain less than this
share of what it does."""
GO_ON, GAIN = 3, 0.02
"""A refinement of less support is gone on with so often, while it gains so much of it."""
UNKNOWN = 0.03, np.deg2rad(3.0)
"""Standard deviations (m, rad) from when on nothing is written."""
LATE = 0.02
"""Lag (s) from when on it is worth saying."""


@dataclass(frozen=True)
class ArmFit:
    """A camera, tried by the arm's motion."""

    refined: Refined
    support: float
    """Share of the arm's contour that has an edge where it should be."""
    overlap: float
    """How well the coarse search's pose explains what changes, from 0 to 1."""
    film: Film = field(repr=False)

    @property
    def base_from_camera(self) -> np.ndarray:
        """[4, 4], OpenCV axes."""
        return self.refined.solution.base_from_camera

    @property
    def late(self) -> float | None:
        """Time (s) by which pictures are later than states, if that is clear and much."""
        lag, sigma = self.refined.solution.lag, self.refined.lag_sigma
        return lag if abs(lag) > max(LATE, 4 * sigma) else None


def fit_arm(arm: ArmModel, film: Film) -> ArmFit:
    """Finds the camera.

    Args:
        arm: The robot.
        film: Pictures of a camera that stands still.

    Raises:
        DatasetError: The pose is not determined; the message says why.
    """
    _check_motion(film)
    changes = changes_of(arm, film)
    _check_changes(film, changes)
    poses, overlaps = search(changes, changes_of(arm, film, FINE))
    refiner = Refiner(arm, film)
    near = NEAR * refiner.scale
    tried: list[tuple[float, int, Refined]] = []
    rivals = int((overlaps > RIVAL * overlaps[0]).sum())
    for i in range(min(max(rivals, 2), len(poses))):
        start = Solution(poses[i], np.zeros(arm.joints), 0.0)
        refined = refiner.refine(start)
        tried.append((refined.support(near), i, refined))
        if rivals == 1 and refined.support(near) > CLEARLY:
            break
    if max(one[0] for one in tried) <= CLEARLY:  # all of them, or they could not be compared
        settled = [(i, _settled(refiner, refined, near)) for _, i, refined in tried]
        tried = [(refined.support(near), i, refined) for i, refined in settled]
    tried.sort(key=lambda one: (-one[0], one[1]))
    support, index, best = tried[0]
    fit = ArmFit(best, support, float(overlaps[index]), film)
    if support < SUPPORT:
        raise DatasetError(_unexplained(arm, film, fit, poses))
    for other, _, refined in tried[1:]:
        place, turn = apart(fit.base_from_camera, refined.solution.base_from_camera)
        if other > ALIKE * support and (place > ELSEWHERE[0] or turn > ELSEWHERE[1]):
            raise DatasetError(
                f"Two poses explain the arm's motion alike, {100 * float(place):.0f} cm and "
                f"{np.rad2deg(float(turn)):.0f} degrees apart ({support:.0%} and {other:.0%} of "
                "the contour lie on edges). Use more episodes, or some in which the arm moves in "
                "other directions, also towards the camera and away from it."
            )
    place, turn = best.spread
    if place > UNKNOWN[0] or turn > UNKNOWN[1]:
        raise DatasetError(
            f"The arm's motion does not tell the camera's pose: it is sure to {1000 * place:.0f} "
            f"mm and {np.rad2deg(turn):.1f} degrees only. Use more episodes (--episodes), or some "
            "in which more of the arm moves farther in the picture."
        )
    return fit


def _settled(refiner: Refiner, refined: Refined, near: float) -> Refined:
    """A refinement that put little of the contour on edges, gone on with while that helps."""
    for _ in range(GO_ON):
        again = refiner.refine(refined.solution, REACHES[2:])
        if again.support(near) < refined.support(near) + GAIN:
            break
        refined = again
    return refined


def _check_motion(film: Film) -> None:
    far = max(
        float(np.linalg.norm(film.angles[rows][:, None] - film.angles[rows][None], axis=-1).max())
        for rows in film.by_episode()
    )
    if far < LEAST_MOTION:
        raise DatasetError(
            f"Too little motion: within an episode the joints differ by {far:.3f} rad at most, "
            f"expected {LEAST_MOTION} and more. Use episodes in which the arm moves, or look "
            "whether --joints names its joints."
        )


def _check_changes(film: Film, changes: MotionCells) -> None:
    change = float(changes.share.sum(1).mean())
    if change < LEAST_CHANGE:
        raise DatasetError(
            f"The arm is not in view, or hardly: while its joints move, {change:.1f} of "
            f"{changes.share.shape[1]} parts of the picture change, expected {LEAST_CHANGE:.0f} "
            f"and more, in {len(np.unique(film.episodes))} episodes. Look at the pictures of this "
            "view: a camera that sees little of the arm, or pictures that stand still."
        )


def _unexplained(arm: ArmModel, film: Film, fit: ArmFit, poses: np.ndarray) -> str:
    """Why no pose explains the pictures, as far as that can be told."""
    words = (
        f"No pose of the camera explains the arm's motion: {fit.support:.0%} of its contour lie on "
        f"edges, expected {SUPPORT:.0%} and more."
    )
    lags = np.array([-0.6, -0.4, -0.2, 0.2, 0.4, 0.6])
    shifted = [
        Film(film.K, film.rgb, film.angles + lag * film.speeds, film.speeds, film.opening,
             film.episodes, film.steps, film.masks)
        for lag in lags
    ]  # fmt: skip
    fits = [float(changes_of(arm, other).fits(poses[:8]).max()) for other in shifted]
    best = int(np.argmax(fits))
    if fits[best] > 1.15 * fit.overlap:
        when = "later" if lags[best] > 0 else "earlier"
        return (
            f"{words} Joint states are out of sync with pictures: they fit better if pictures are "
            f"taken about {abs(lags[best]):.1f} s {when} than the states beside them."
        )
    return (
        f"{words} Likely causes: the camera moved between these episodes, or is on the arm; other "
        "joints or another robot (--joints, --robot); K of another picture; pictures of another "
        "episode, or time, than the states; much else that moves."
    )
