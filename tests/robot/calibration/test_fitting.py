"""Least squares of pixels."""

import numpy as np

from jaxcam.robot.calibration.fitting import fit_pixels

AT = np.linspace(0, 1, 40)


def line(noise=0.1, seed=0):
    rng = np.random.default_rng(seed)
    return np.c_[2 + 3 * AT, 1 - AT] + rng.normal(0, noise, (40, 2))


def test_outliers_do_not_count_and_the_covariance_is_that_of_the_noise():
    errors, sigmas = [], []
    for seed in range(30):
        points = line(seed=seed)
        points[7] += 30
        fitted = fit_pixels(lambda x, s=points: np.c_[x[0] + x[1] * AT, 1 - AT] - s, np.zeros(2))
        assert not fitted.used[7]
        assert fitted.used.sum() >= 38
        errors.append(fitted.values - [2, 3])
        sigmas.append(np.sqrt(np.diag(fitted.covariance)))
    np.testing.assert_allclose(np.std(errors, 0), np.mean(sigmas, 0), rtol=0.4)


def test_what_changes_nothing_is_not_determined():
    points = line()
    fitted = fit_pixels(lambda x: np.c_[x[0] + x[1] * AT, 1 - AT + 0 * x[2]] - points, np.zeros(3))
    assert fitted.covariance[2, 2] > 1e6 * fitted.covariance[0, 0]
    held = fit_pixels(
        lambda x: np.c_[x[0] + x[1] * AT, 1 - AT + 0 * x[2]] - points,
        np.zeros(3), prior=np.array([np.inf, np.inf, 0.5]),
    )  # fmt: skip
    assert 0.1 < np.sqrt(held.covariance[2, 2]) < 1.0


def test_derivatives_of_ones_own_give_the_same():
    points = line()
    slopes = np.zeros((40, 2, 2))
    slopes[:, 0] = np.c_[np.ones(40), AT]
    fits = [
        fit_pixels(lambda x: np.c_[x[0] + x[1] * AT, 1 - AT] - points, np.zeros(2), jacobian=j)
        for j in (None, lambda x: slopes)
    ]
    np.testing.assert_allclose(fits[0].values, fits[1].values, atol=1e-6)
