"""The noise schedule and the samplers of Diffusion Policy, against golden numbers."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import places
import pytest

from jaxcam.models.diffusion.samplers import add_noise, cosine_alphas, make_table, sample

GOLDEN = json.loads((places.GOLDEN / "schedules.json").read_text())


def test_schedule_is_the_golden_one():
    golden = GOLDEN["ddpm100_squaredcos"]
    alphas = cosine_alphas(100)
    np.testing.assert_allclose(alphas, golden["alphas_cumprod"], rtol=1e-5)
    betas = 1 - alphas / np.append(np.float32(1), alphas[:-1])
    np.testing.assert_allclose(betas, golden["betas"], rtol=1e-3)


def test_ddim_visits_the_golden_steps():
    for steps, expected in GOLDEN["ddim_timesteps_leading"].items():
        table = make_table("ddim", cosine_alphas(100), int(steps))
        assert table.t.tolist() == expected


@pytest.mark.parametrize(
    ("t", "variance", "clean", "noisy"),
    [
        (1, 4.0348663e-4, 0.63896185, 0.36104387),
        (50, 0.030604385, 0.04249065, 0.9547153),
        (99, 0.99875766, 0.015568295, 0.031614903),
    ],
)
def test_ddpm_posterior_is_the_golden_one(t, variance, clean, noisy):
    table = make_table("ddpm", cosine_alphas(100), 100)
    row = jax.tree.map(lambda x: x[99 - t], table)
    assert row.t == t
    assert [row.fresh**2, row.clean, row.noisy] == pytest.approx([variance, clean, noisy], rel=1e-4)
    assert table.fresh[-1] == 0


@pytest.mark.parametrize("sampler", ["ddpm", "ddim"])
def test_a_predictor_that_knows_the_sample_gets_it_back(sampler):
    alphas = cosine_alphas(100)
    clean = jax.random.uniform(jax.random.key(0), (2, 4, 3), minval=-1)

    def predict(x, t):
        share = jnp.asarray(alphas)[t]
        return (x - jnp.sqrt(share) * clean) / jnp.sqrt(1 - share)

    x = jax.random.normal(jax.random.key(1), clean.shape)
    fresh = jax.random.normal(jax.random.key(2), (10, *clean.shape))
    sampled = sample(make_table(sampler, alphas, 10), predict, x, fresh)
    np.testing.assert_allclose(sampled, clean, atol=1e-4)


def test_noise_is_added_by_the_schedule():
    alphas = cosine_alphas(100)
    x, noise = jnp.ones((2, 3, 1)), 2 * jnp.ones((2, 3, 1))
    noisy = add_noise(alphas, x, noise, jnp.array([0, 99]))[:, 0, 0]
    np.testing.assert_allclose(noisy, np.sqrt(alphas[[0, 99]]) + 2 * np.sqrt(1 - alphas[[0, 99]]))
