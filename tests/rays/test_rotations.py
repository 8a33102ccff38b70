"""Rotations agree with MuJoCo's, survive round trips up to half a turn, and run under JAX."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from jaxcam.rays.rotations import (
    matrix_from_quaternion,
    matrix_from_rotvec,
    quaternion_from_matrix,
    rotvec_from_matrix,
    skew,
)

ANGLES = [0.0, 1e-9, 1e-4, 0.1, 1.0, 3.0, np.pi - 1e-3, np.pi - 1e-7, np.pi]


def axes(count, seed=0):
    v = np.random.default_rng(seed).normal(size=(count, 3))
    v = np.concatenate([v, np.eye(3), -np.eye(3)])
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


@pytest.mark.parametrize("angle", ANGLES)
def test_round_trips(angle):
    rotvec = angle * axes(20)
    matrix = matrix_from_rotvec(rotvec)
    np.testing.assert_allclose(matrix @ matrix.swapaxes(-1, -2), np.eye(3) + 0 * matrix, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(matrix), 1)
    back = rotvec_from_matrix(matrix)
    np.testing.assert_allclose(matrix_from_rotvec(back), matrix, atol=1e-12)
    if angle < np.pi:  # at half a turn both signs are right
        np.testing.assert_allclose(back, rotvec, atol=1e-8)
    quaternion = quaternion_from_matrix(matrix)
    assert (quaternion[..., 0] >= 0).all()
    np.testing.assert_allclose(matrix_from_quaternion(quaternion), matrix, atol=1e-12)


def test_agrees_with_mujoco():
    for rotvec in 2.5 * axes(10, seed=1):
        quaternion, matrix = np.empty(4), np.empty(9)
        mujoco.mju_axisAngle2Quat(quaternion, rotvec / 2.5, 2.5)
        mujoco.mju_quat2Mat(matrix, quaternion)
        np.testing.assert_allclose(matrix_from_rotvec(rotvec), matrix.reshape(3, 3), atol=1e-12)
        np.testing.assert_allclose(
            quaternion_from_matrix(matrix.reshape(3, 3)), quaternion, atol=1e-12
        )


def test_batches_of_any_shape():
    rotvec = np.random.default_rng(2).normal(size=(2, 1, 3, 3))
    matrix = matrix_from_rotvec(rotvec)
    assert matrix.shape == (2, 1, 3, 3, 3)
    np.testing.assert_array_equal(matrix[1, 0, 2], matrix_from_rotvec(rotvec[1, 0, 2]))
    assert rotvec_from_matrix(matrix).shape == rotvec.shape


def test_jax_gives_the_same_and_finite_gradients_at_zero():
    rotvec = 2 * axes(5)
    matrix = jax.jit(matrix_from_rotvec)(jnp.asarray(rotvec))
    np.testing.assert_allclose(matrix, matrix_from_rotvec(rotvec), atol=1e-6)
    np.testing.assert_allclose(jax.jit(rotvec_from_matrix)(matrix), rotvec, atol=1e-5)
    # d exp(v)/dv at 0 is the cross product's matrix: sum over entries of R against a constant.
    weight = jnp.arange(9.0).reshape(3, 3)
    gradient = jax.grad(lambda v: (matrix_from_rotvec(v) * weight).sum())(jnp.zeros(3))
    expected = [(np.asarray(skew(e)) * np.asarray(weight)).sum() for e in np.eye(3)]
    np.testing.assert_allclose(gradient, expected, atol=1e-6)


def test_skew_is_the_cross_product():
    u, v = np.random.default_rng(3).normal(size=(2, 4, 3))
    np.testing.assert_allclose((skew(v) @ u[..., None])[..., 0], np.cross(v, u))
