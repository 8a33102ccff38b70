"""Least squares of pixels: what is far off is left out, the rest says how sure the result is."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

PIXEL = 0.1
"""What corners of a good picture are off (pixels), until residuals of this picture say more."""
WEIGHT = 8
"""As many residuals as that guess is worth."""
FAR = 5.0
"""Residuals beyond so many standard deviations are no corners."""
SOFT = 1.0
"""At first, residuals count in full up to here (pixels)."""
STEPS = 40
LEAST_FAR = 0.5
"""But not those that are off by less (pixels)."""


@dataclass(frozen=True)
class Fitted:
    """The result of a fit with P unknowns to N pixels."""

    values: np.ndarray
    """Of the unknowns, float64 [P]."""
    covariance: np.ndarray
    """Of the unknowns, float64 [P, P]; very large where they are not determined."""
    residuals: np.ndarray
    """Of all pixels, also those left out, float64 [N, 2]."""
    used: np.ndarray
    """Which pixels count, bool [N]."""
    sigma: float
    """Standard deviation of a coordinate (pixels)."""

    @property
    def rms(self) -> float:
        """Root mean square of the distances in pixels, of the pixels that count."""
        return float(np.sqrt((self.residuals[self.used] ** 2).sum(-1).mean()))


def fit_pixels(
    residuals: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    *,
    jacobian: Callable[[np.ndarray], np.ndarray] | None = None,
    prior: np.ndarray | None = None,
) -> Fitted:
    """Fits unknowns to pixels: robustly first, then to those that are not far off.

    Args:
        residuals: Of the unknowns [P], the pixels' residuals [N, 2].
        start: Where to begin, [P].
        jacobian: Of the unknowns, the residuals' derivatives [N, 2, P]; by central differences when
            None.
        prior: Standard deviations of the unknowns about `start` before anything was seen, [P];
            infinite where nothing is known.
    """
    prior = np.full(len(start), np.inf) if prior is None else prior
    pull = np.where(np.isfinite(prior), PIXEL / prior, 0)
    slopes = jacobian or (lambda x: numeric_jacobian(residuals, x))
    problem = _Problem(residuals, slopes, np.asarray(start, float), pull)
    count = len(residuals(start))
    x = _descend(problem, start, np.ones(count, bool), SOFT)
    used = np.ones(count, bool)
    for _ in range(4):
        distances = np.linalg.norm(residuals(x), axis=-1)
        spread = np.median(distances[used]) / 1.1774  # of one coordinate, by Rayleigh's median
        keep = distances < max(FAR * spread, LEAST_FAR)
        # Fewer pixels than unknowns say nothing: then all stay.
        before, used = used, keep if 2 * keep.sum() > len(x) else used
        x = _descend(problem, x, used, np.inf)
        if (before == used).all():
            break
    final = residuals(x)
    squares = float((final[used] ** 2).sum())
    freedom = max(2 * int(used.sum()) + np.count_nonzero(pull) - len(x), 0)
    sigma = float(np.sqrt((WEIGHT * PIXEL**2 + squares) / (WEIGHT + freedom)))
    normal = problem.normal(x, used.astype(float))[0]
    return Fitted(x, sigma**2 * _inverse(normal), final, used, sigma)


@dataclass(frozen=True)
class _Problem:
    """What is fitted."""

    residuals: Callable[[np.ndarray], np.ndarray]
    slopes: Callable[[np.ndarray], np.ndarray]
    start: np.ndarray
    pull: np.ndarray
    """Towards `start`, per unknown."""

    def cost(self, x: np.ndarray, used: np.ndarray, soft: float) -> float:
        """Half the squares; of residuals beyond `soft`, growing with their length (Huber)."""
        length = np.linalg.norm(self.residuals(x)[used], axis=-1)
        near = length <= soft
        far = soft * (length[~near] - soft / 2) if np.isfinite(soft) else 0
        return float((length[near] ** 2).sum() / 2 + np.sum(far)) + self.held(x)

    def held(self, x: np.ndarray) -> float:
        return float(((self.pull * (x - self.start)) ** 2).sum() / 2)

    def normal(self, x: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The normal matrix [P, P] and the gradient [P] of weighted squares."""
        J = (self.slopes(x) * np.sqrt(weights)[:, None, None]).reshape(-1, len(x))
        r = (self.residuals(x) * np.sqrt(weights)[:, None]).ravel()
        return J.T @ J + np.diag(self.pull**2), J.T @ r + self.pull**2 * (x - self.start)


def _descend(problem: _Problem, x: np.ndarray, used: np.ndarray, soft: float) -> np.ndarray:
    """Levenberg's and Marquardt's steps: with some hundred unknowns, SciPy's take seconds each."""
    cost, damping = problem.cost(x, used, soft), 1e-4
    for _ in range(STEPS):
        length = np.linalg.norm(problem.residuals(x), axis=-1)
        weights = used * np.minimum(1, soft / np.maximum(length, 1e-12))
        H, g = problem.normal(x, weights)
        scale = np.sqrt(np.maximum(np.diag(H), 1e-12))
        H, g = H / np.outer(scale, scale), g / scale
        while damping < 1e8:
            ahead = x - np.linalg.solve(H + damping * np.eye(len(x)), g) / scale
            lower = problem.cost(ahead, used, soft)
            if np.isfinite(lower) and lower < cost:
                break
            damping *= 8
        else:
            return x
        gain, x, cost, damping = cost - lower, ahead, lower, max(damping / 10, 1e-12)
        if gain <= 1e-6 * cost + 1e-12:
            return x
    return x


def numeric_jacobian(residuals: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    """Derivatives by central differences, [N, 2, P]; unknowns are metres, radians and the like."""
    steps = 1e-6 * np.eye(len(x))
    return np.stack([(residuals(x + s) - residuals(x - s)) / 2e-6 for s in steps], -1)


def _inverse(normal: np.ndarray) -> np.ndarray:
    """Of a normal matrix; very large along what changes no pixel."""
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-12))
    values, turn = np.linalg.eigh(normal / np.outer(scale, scale))
    root = turn / np.sqrt(np.maximum(values, 1e-14)) / scale[:, None]
    return root @ root.T
