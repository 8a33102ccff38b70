"""Flow matching: the embedding of time, its draws, and Euler's steps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcam.models.smolvla.flow import draw_time, integrate, line, time_embedding


def test_time_embedding_is_the_golden_one():
    embedded = np.asarray(time_embedding(jnp.array([0.1], jnp.float32), 720))[0]
    golden = {0: 0.0, 1: -0.14747328557070905, 359: 0.15643446504023087, 360: 1.0}
    golden |= {361: -0.9890660392728992, 719: 0.9876883405951378}
    for channel, value in golden.items():
        # The golden numbers are for 0.1, and float32's 0.1 is 1.5e-9 more.
        assert embedded[channel] == pytest.approx(value, abs=4e-6)


def test_times_are_beta_distributed():
    times = np.asarray(draw_time(jax.random.key(0), 200_000))
    assert times.min() >= 0.001
    assert times.max() <= 1
    assert times.mean() == pytest.approx(0.6004, abs=3e-3)
    assert times.std() == pytest.approx(0.2616, abs=3e-3)


def test_euler_follows_a_straight_line_exactly():
    rng = np.random.default_rng(0)
    action, noise = (jnp.asarray(rng.normal(size=(2, 4, 3)), jnp.float32) for _ in range(2))
    x, velocity = line(action, noise, jnp.array([0.25, 1.0]))
    np.testing.assert_allclose(x[1], noise[1])
    np.testing.assert_allclose(x[0], action[0] + 0.25 * velocity[0], rtol=1e-5, atol=1e-6)
    asked = []
    with jax.disable_jit():
        result = integrate(lambda x, t: asked.append(float(t[0])) or velocity, noise, 10)
    np.testing.assert_allclose(result, action, atol=1e-5)
    np.testing.assert_allclose(asked, np.arange(10, 0, -1) / 10, rtol=1e-6)
