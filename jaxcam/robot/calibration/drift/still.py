"""In which episodes a camera stood where it usually does: runs of episodes held against the rest.

A camera that was pushed stays where it is for a while. Episodes in a row are told together what one
of them could not tell; the rest is what they are held against.
"""

import numpy as np

from jaxcam.robot.calibration.projection import spread_of

FLOOR = np.diag(np.square(np.repeat([0.0003, np.deg2rad(0.015)], 3)))
"""Covariance (m, rad) that a change has at least, however many episodes ask for it."""
SWING = np.deg2rad(0.2)
"""Standard deviation (rad) of a turn about the arm that an episode may ask for though nothing
moved: such a turn changes the picture's perspective alone, by less than edges are off."""
LIMIT = 30.0
"""Squared distance, in standard deviations, beyond which a camera has moved. On films of seven
development cameras still ones had up to 19, and all that were moved by 1 cm or 1 degree 45 or
more."""
LEAST = 0.004, np.deg2rad(0.25)
"""Changes (m, rad) below both of which nothing is said."""
UNSURE = 0.012, np.deg2rad(0.75)
"""Standard deviations (m, rad) of what single episodes ask for, in the median, from which on they
do not tell that a camera stood still; on drawn films they are 3 to 6 mm and 0.2 to 0.4 degrees."""
DOUBTED = 4.0
"""Times `LIMIT` that squared distances are then held to: pictures of 72 rows only seem to tell some
directions well."""
LEAST_OFF = 0.1
"""Share of a contour that is off its edges on the best of pictures."""
SHARE, ENOUGH = 0.25, 4
"""Share of the episodes, or their number, that is enough to be what others are held against."""
EXPLAINED = 2.5
"""What most episodes may ask for together (centimetres or degrees) as the fault of joints."""
NEXT_TO_NOTHING = 1 / 3
"""Share of what most ask for, up to which others ask for next to nothing."""
USUAL_DOUBT, USUAL_PAIRS = 7.0, 4
"""What `doubt` is in the median there, and as how many pairs of neighbours that counts."""
TYPICAL = 5.35
"""Median of the squared length of six normal numbers."""


def astray(supports: np.ndarray) -> np.ndarray:
    """By how much covariances are too small where less of the contour lies on edges than in most.

    What is not on its own edge is in part on another's, and pulls.

    Args:
        supports: Shares of the contours that lie on edges, [n].
    """
    off = 1 - supports
    return np.maximum(1.0, off / max(float(np.median(off)), LEAST_OFF)) ** 2


def doubt(changes: np.ndarray, spreads: np.ndarray) -> float:
    """By how much covariances are too small: neighbours differ by chance, but where one moved.

    Few neighbours tell it badly, so what is usual counts as `USUAL_PAIRS` more of them.

    Args:
        changes: What episodes ask for, in their order, [n, 6].
        spreads: Covariances, [n, 6, 6].
    """
    pairs, measured = len(changes) - 1, 0.0
    if pairs > 2:
        steps = distances(np.diff(changes, axis=0), spreads[1:] + spreads[:-1])
        measured = pairs * np.log(max(1.0, float(np.median(steps)) / TYPICAL))
    else:
        pairs = 0
    return float(np.exp((measured + USUAL_PAIRS * np.log(USUAL_DOUBT)) / (pairs + USUAL_PAIRS)))


def swings(arm_at: np.ndarray) -> np.ndarray:
    """Covariances of turns about the arm, as small motions of the camera.

    About the line of sight alone there is none: it turns the arm's picture.

    Args:
        arm_at: Where the arm is before the camera (m), [n, 3].

    Returns:
        [n, 6, 6], of metres and radians.
    """
    # About a point p, a turn w takes the camera along by p x w.
    along = np.cross(arm_at[:, None], np.eye(3))
    sight = arm_at / np.linalg.norm(arm_at, axis=-1, keepdims=True)
    both = np.concatenate([along, np.eye(3) - sight[:, :, None] * sight[:, None]], -1)
    return SWING**2 * np.einsum("nki,nkj->nij", both, both)


def single_spread(spreads: np.ndarray) -> tuple[float, float]:
    """Standard deviations (m, rad) of what single episodes ask for, in the median.

    Args:
        spreads: Covariances, [n, 6, 6].
    """
    place, turn = np.median([spread_of(spread) for spread in spreads], 0)
    return float(place), float(turn)


def are_unsure(spreads: np.ndarray) -> bool:
    """Whether single episodes ask for too different things to tell that a camera stood still."""
    return any(np.greater(single_spread(spreads), UNSURE))


def limit_of(spreads: np.ndarray) -> float:
    """Squared distance beyond which a camera has moved, by what single episodes can tell."""
    return LIMIT * (DOUBTED if are_unsure(spreads) else 1)


def still_episodes(changes: np.ndarray, spreads: np.ndarray, limit: float) -> np.ndarray:
    """In which episodes the camera stood where it did in most.

    Where most ask for more than joints can be off by, and enough others for less, these are meant:
    the camera was pushed early, and stayed there. So it is where others ask for next to nothing:
    what joints are off by is hardly undone by a push.

    Args:
        changes: What episodes ask for, in their order, [n, 6].
        spreads: Covariances, [n, 6, 6].
        limit: See `limit_of`.

    Returns:
        Bool [n].
    """
    still = np.ones(len(changes), bool)
    while still.sum() > 1:
        rows = np.flatnonzero(still)
        run = _strangest(changes[rows], spreads[rows], limit)
        if run is None:
            break
        sides = rows[run[0] : run[1]], np.delete(rows, slice(*run))
        kept, other = sorted(sides, key=len, reverse=True)
        enough = len(other) >= max(min(SHARE * len(changes), ENOUGH), 2) or len(kept) == 1
        far, near = (float(size(mean(changes[s], spreads[s])[0])) for s in (kept, other))
        pushed = far > EXPLAINED or near < NEXT_TO_NOTHING * far or len(kept) == len(other)
        if enough and near < far and pushed:
            kept = other
        still[rows] = np.isin(rows, kept)
    return still


def stands_out(
    own: np.ndarray, rest: np.ndarray, changes: np.ndarray, spreads: np.ndarray, limit: float
) -> bool:
    """Whether some episodes ask together for something else than the rest.

    Args:
        own: Numbers of the episodes.
        rest: Of those that they are held against.
        changes: What episodes ask for, [n, 6].
        spreads: Covariances, [n, 6, 6].
        limit: See `limit_of`.
    """
    (one, covariance), (other, doubt_of_rest) = (mean(changes[s], spreads[s]) for s in (own, rest))
    away = one - other
    far = np.linalg.norm(away[:3]) > LEAST[0] or np.linalg.norm(away[3:]) > LEAST[1]
    return bool(far and distances(away, covariance + doubt_of_rest + FLOOR) > limit)


def _strangest(changes: np.ndarray, spreads: np.ndarray, limit: float) -> tuple[int, int] | None:
    """The run of episodes [first, last) that differs most from the rest; None if none does."""
    weights = np.linalg.inv(spreads)
    pulls = (weights @ changes[..., None])[..., 0]
    sums, totals = (
        np.concatenate([np.zeros_like(a[:1]), np.cumsum(a, 0)]) for a in (weights, pulls)
    )
    best, strangest = limit, None
    for first in range(len(changes)):  # of all runs at once there would be too many for memory
        last = np.arange(first + 1, len(sums))
        last = last[last - first < len(changes)]
        own, rest = sums[last] - sums[first], sums[-1] - (sums[last] - sums[first])
        pull = totals[last] - totals[first]
        own, rest = np.linalg.inv(own), np.linalg.inv(rest)
        away = (own @ pull[..., None] - rest @ (totals[-1] - pull)[..., None])[..., 0]
        far = (np.linalg.norm(away[:, :3], axis=-1) > LEAST[0]) | (
            np.linalg.norm(away[:, 3:], axis=-1) > LEAST[1]
        )
        strange = np.where(far, distances(away, own + rest + FLOOR), 0.0)
        if strange.max(initial=0.0) > best:
            best, strangest = strange.max(), (first, int(last[strange.argmax()]))
    return strangest


def mean(changes: np.ndarray, spreads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What several episodes ask for together, [6], and its covariance."""
    weights = np.linalg.inv(spreads)
    covariance = np.linalg.inv(weights.sum(0))
    return covariance @ np.einsum("nij,nj->i", weights, changes), covariance


def size(changes: np.ndarray) -> np.ndarray:
    """How large changes [..., 6] are, a centimetre being as much as a degree."""
    return np.hypot(
        np.linalg.norm(changes[..., :3], axis=-1) / 0.01,
        np.linalg.norm(changes[..., 3:], axis=-1) / np.deg2rad(1),
    )


def distances(changes: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """Squared lengths [...] of changes [..., 6] in standard deviations."""
    return np.einsum(
        "...i,...i->...", changes, np.linalg.solve(covariances, changes[..., None])[..., 0]
    )
