"""Diffusion Policy as functions: what it learns, samples and listens to."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from policy_inputs import (
    ACTION,
    CHUNK,
    OUTSIDE_ATTENTION,
    jit,
    make_batch,
    moved,
    start,
)
from tiny_diffusion import make, ranges, tiny

from jaxcam.models import make_policy
from jaxcam.models.crops import window
from jaxcam.rays import plucker


@pytest.mark.parametrize("conditioning", OUTSIDE_ATTENTION)
def test_every_conditioning_learns_and_hears_what_it_should(conditioning):
    config, batch = tiny(conditioning=conditioning), make_batch()
    policy = make(config)
    params = start(policy)
    plain = make_policy(config, policy.spec, ranges())
    grads = jit(jax.grad(lambda p: plain.loss(p, batch, jax.random.key(1))[0]))(params)
    assert all(np.isfinite(g).all() and (g != 0).any() for g in jax.tree.leaves(grads))
    key = jax.random.key(0)
    here, there = policy.act(params, batch, key), policy.act(params, moved(batch), key)
    assert here.shape == (2, CHUNK, ACTION)
    assert np.array_equal(here, there) == (conditioning == "none")


def test_noise_comes_only_from_the_key():
    policy, batch = make(tiny(sampler="ddpm", temperature=1.0)), make_batch()
    params = start(policy)
    for function in (policy.act, lambda *a: policy.loss(*a)[0]):
        a, b, c = (np.asarray(function(params, batch, jax.random.key(k))) for k in (1, 1, 2))
        assert np.array_equal(a, b)
        assert not np.array_equal(a, c)
        alone = function(params, batch, None)
        np.testing.assert_array_equal(alone, function(params, batch, None))


@pytest.mark.parametrize("sampler", ["ddpm", "ddim"])
def test_the_colder_the_less_actions_vary(sampler):
    batch, spreads = make_batch(), []
    for temperature in (1.0, 0.1, 0.0):
        policy = make(tiny(sampler=sampler, temperature=temperature))
        params = start(policy)
        drawn = [np.asarray(policy.act(params, batch, jax.random.key(k))) for k in range(4)]
        spreads.append(np.std(drawn, 0).mean())
    assert spreads[0] > 2 * spreads[1] > spreads[2]
    assert spreads[2] == 0
    np.testing.assert_array_equal(drawn[0], policy.act(params, batch, None))


def test_actions_stay_in_the_range_of_the_data():
    policy, stats = make(tiny()), ranges()
    actions = policy.act(start(policy), make_batch(), jax.random.key(0))
    assert (actions >= stats["action_min"] - 1e-5).all()
    assert (actions <= stats["action_max"] + 1e-5).all()


def test_padded_actions_do_not_matter():
    policy, batch = make(tiny()), make_batch()
    params = start(policy)
    junk = batch | {"action": np.where(batch["is_pad"][..., None], 1e6, batch["action"])}
    a, b = (policy.loss(params, some, None)[0] for some in (batch, junk))
    assert float(a) == pytest.approx(float(b), rel=1e-6)


def history(batch, steps):
    """The same observation at every step."""
    observed = ("image", "K", "base_from_camera", "proprio")
    return batch | {k: np.stack([batch[k]] * steps, 1) for k in observed}


def test_several_observations():
    config = tiny(obs_steps=2, crop=12, encoder_per_view=True)
    policy, batch = make(config, views=2), history(make_batch(views=2), 2)
    params = start(policy)
    assert len(params["vision"]) == 2
    assert policy.execute == CHUNK - 1
    actions = policy.act(params, batch, jax.random.key(0))
    assert actions.shape == (2, CHUNK - 1, ACTION)
    older = {k: batch[k].copy() for k in ("image", "proprio")}
    older["image"][:, 0] = 0
    changed = policy.act(params, batch | older, jax.random.key(0))
    assert not np.array_equal(actions, changed)
    assert np.isfinite(policy.loss(params, batch, jax.random.key(0))[0])


@pytest.mark.parametrize("key", [None, jax.random.key(3)])
def test_a_window_keeps_every_pixels_ray(key):
    batch = {k: jnp.asarray(v) for k, v in make_batch(16).items()}
    image = jnp.broadcast_to(jnp.arange(16.0)[:, None, None] * 16, (2, 1, 16, 16, 3))
    image = image + jnp.arange(16.0)[:, None]
    cut = window(batch | {"image": image}, 12, key)
    assert cut["image"].shape == (2, 1, 12, 12, 3)
    rays = plucker(batch["K"], batch["base_from_camera"], 16, 16)
    small = plucker(cut["K"], batch["base_from_camera"], 12, 12)
    for b in range(2):
        row, column = divmod(int(cut["image"][b, 0, 0, 0, 0]), 16)
        assert key is not None or (row, column) == (2, 2)
        there = rays[b, 0, row : row + 12, column : column + 12]
        np.testing.assert_allclose(small[b, 0], there, atol=1e-5)
