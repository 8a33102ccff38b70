"""Faults of joints that all episodes share."""

import numpy as np
from boxed_arm import CAMERA, boxed_arm, film

from jaxcam.robot.calibration.arm.refine import Equations, Refiner
from jaxcam.robot.calibration.drift.change import ask
from jaxcam.robot.calibration.drift.shared import shared_faults, solve_shared
from jaxcam.robot.calibration.projection import moved

BUMP = np.r_[0.0, 0.0, 0.0, np.deg2rad([0.8, -0.8, 0.0])]


def test_the_equations_of_all_episodes_are_solved_at_once():
    """Each asks for what is true along some directions only; one camera of six had moved."""
    rng, common = np.random.default_rng(0), np.r_[0.002, 0.001, -0.001, 0.003, 0.0, 0.001]
    faults = np.r_[0.004, -0.003, 0.002, 0.01]
    equations, steps = [], []
    for episode in range(6):
        rows = rng.normal(0, 1, (8, 10))  # fewer than the unknowns of one episode
        step = common + 10 * BUMP * (episode == 5)
        normal = 1e9 * rows.T @ rows
        equations.append(Equations(normal, normal @ np.r_[step, faults], 1.0))
        steps.append(step)
    got, more = solve_shared(equations, np.zeros((6, 6)), np.zeros(4))
    np.testing.assert_allclose(more, faults, atol=2e-5)
    np.testing.assert_allclose(got[:5], steps[:5], atol=2e-5)


def test_episodes_know_more_together_than_each():
    off = np.deg2rad([0.0, 0.4, -0.3])
    shown = film([CAMERA] * 5 + [moved(CAMERA, BUMP)], off=tuple(off))
    films = [shown.some(shown.episodes == e) for e in range(6)]
    refiners = [Refiner(boxed_arm(), one) for one in films]
    shared = shared_faults(refiners, [CAMERA] * 6, [CAMERA] * 6, (8.0, 5.0, 4.0))
    alone = np.median([ask(boxed_arm(), one, CAMERA).joints for one in films], 0)
    assert np.linalg.norm(shared.joints + off) < 0.8 * np.linalg.norm(alone + off)
    assert abs(shared.lag) < 0.01
