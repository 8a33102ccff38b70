"""The Panda's arm in NumPy."""

import numpy as np

from jaxcam.rays.rotations import rotvec_from_matrix
from jaxcam.sim.maniskill import kinematics
from jaxcam.sim.maniskill.kinematics import forward, inverse
from jaxcam.sim.maniskill.scene import HOME


def test_the_jacobian_is_the_derivative():
    q = HOME + np.random.default_rng(0).normal(0, 0.3, (4, 7))
    position, rotation, jacobian = forward(q)
    for i in range(7):
        moved, turned, _ = forward(q + 1e-6 * np.eye(7)[i])
        np.testing.assert_allclose((moved - position) / 1e-6, jacobian[:, :3, i], atol=1e-5)
        turn = rotvec_from_matrix(turned @ rotation.mT) / 1e-6
        np.testing.assert_allclose(turn, jacobian[:, 3:, i], atol=1e-5)


def test_inverse_kinematics_reaches_and_stays_within_limits():
    rng = np.random.default_rng(1)
    q = HOME + rng.normal(0, 0.1, (50, 7))
    goal, axes, _ = forward(np.clip(q + rng.normal(0, 0.1, q.shape), *kinematics.LIMITS))
    solution = inverse(goal, axes, q, q)
    at, turned, _ = forward(solution)
    assert np.linalg.norm(at - goal, axis=-1).max() < 1e-4
    assert np.linalg.norm(rotvec_from_matrix(turned @ axes.mT), axis=-1).max() < 1e-3
    far = inverse(goal + np.array([2.0, 0, 0]), axes, q, q)  # out of reach: near, and no leaps
    assert np.isfinite(far).all()
    assert (far >= kinematics.LIMITS[0]).all()
    assert (far <= kinematics.LIMITS[1]).all()
