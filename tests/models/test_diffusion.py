"""Diffusion Policy: schedule, samplers, loss, observation steps, and what it refuses."""

import json
from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import places
import pytest
from policy_inputs import (
    ACTION,
    CHUNK,
    CONDITIONINGS,
    PROPRIO,
    jit,
    make_batch,
    make_stats,
    moved,
    shapes,
    start,
)

from jaxcam.errors import ConfigError
from jaxcam.models import PolicySpec, make_policy
from jaxcam.models.crops import window
from jaxcam.models.diffusion.config import DIFFUSION_PRESETS
from jaxcam.models.diffusion.samplers import add_noise, cosine_alphas, make_table, sample
from jaxcam.models.diffusion.unet import Conv1d, Upsample, mish, step_embedding
from jaxcam.models.losses import padded_mean, repeat_ends
from jaxcam.rays import plucker

GOLDEN = json.loads((places.GOLDEN / "schedules.json").read_text())


def ranges():
    stats = make_stats()
    for name in ("action", "proprio"):
        stats[f"{name}_min"] = stats[f"{name}_mean"] - 1.5
        stats[f"{name}_max"] = stats[f"{name}_mean"] + 1.5
    return stats


def tiny(preset="laptop", conditioning="keypoints", **changes):
    twin_of = DIFFUSION_PRESETS[preset].network if conditioning == "none" else conditioning
    sizes = {"chunk": CHUNK, "execute": 0, "channels": (8, 16), "features": 8, "step_width": 8}
    sizes |= {"keypoints": 3, "conditioning": conditioning, "twin_of": twin_of}
    sizes |= {"encoder": "small", "encoder_depth": 1, "encoder_width": 8, "sample_steps": 5}
    return replace(DIFFUSION_PRESETS[preset], **sizes | changes)


@cache
def make(config, views=1, size=16):
    spec = PolicySpec(ACTION, PROPRIO, views, size, size, config.chunk, config.obs_steps)
    policy = make_policy(config, spec, ranges())
    return replace(policy, loss=jit(policy.loss), act=jit(policy.act))


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


def test_step_embedding_is_the_golden_one():
    got = step_embedding(jnp.array([50]), 128)[0]
    for channel, value in GOLDEN["dp_time_emb_d128_t50"].items():
        assert float(got[int(channel)]) == pytest.approx(value, abs=1e-5)


def test_convolutions_over_time_are_those_of_xla():
    from flax import nnx

    x = jax.random.normal(jax.random.key(0), (2, 8, 3))
    dims = ("NWC", "WIO", "NWC")
    for size, stride in ((5, 1), (3, 2), (1, 1)):
        layer = Conv1d(3, 4, size, stride, rngs=nnx.Rngs(0), dtype=jnp.float32)
        pad = [(size // 2, size // 2)]
        expected = jax.lax.conv_general_dilated(
            x, layer.kernel[...], (stride,), pad, dimension_numbers=dims
        )
        np.testing.assert_allclose(layer(x), expected + layer.bias[...], atol=1e-5)
    grow = Upsample(3, rngs=nnx.Rngs(1), dtype=jnp.float32)
    kernel = grow.kernel[...][::-1].swapaxes(1, 2)
    expected = jax.lax.conv_general_dilated(
        x, kernel, (1,), [(2, 2)], lhs_dilation=(2,), dimension_numbers=dims
    )
    np.testing.assert_allclose(grow(x), expected + grow.bias[...], atol=1e-5)


def test_mish():
    x = jnp.linspace(-30, 30, 61)
    np.testing.assert_allclose(mish(x), jax.nn.mish(x), rtol=1e-5, atol=1e-7)
    assert np.isfinite(jax.vmap(jax.grad(mish))(jnp.array([-1e4, 1e4]))).all()


@pytest.mark.parametrize(
    ("rule", "expected"),
    [("counted", 10 / 8), ("zeroed", 6 / 8), ("valid", 6 / 6), ("sample", (0.5 + 4 / 2) / 2)],
)
def test_padding_rules(rule, expected):
    error = jnp.array([[0.0, 0.0, 1.0, 1.0], [2.0, 2.0, 2.0, 2.0]])[..., None]
    is_pad = jnp.array([[False] * 4, [False, False, True, True]])
    assert float(padded_mean(error, is_pad, rule)) == pytest.approx(expected)


def test_padding_repeats_the_nearest_step():
    x = jnp.arange(10.0).reshape(2, 5, 1)
    is_pad = jnp.array([[True, False, False, False, False], [False, False, True, True, True]])
    assert repeat_ends(x, is_pad)[..., 0].tolist() == [[1, 1, 2, 3, 4], [5, 6, 6, 6, 6]]


@pytest.mark.parametrize("conditioning", CONDITIONINGS)
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


def test_paper_has_the_parameters_of_the_authors_network():
    stats = {f"{a}_{k}": np.ones(7) for a in ("action", "proprio") for k in ("mean", "min", "max")}
    config = DIFFUSION_PRESETS["paper"]
    params = shapes(make_policy(config, PolicySpec(7, 7, 1, 256, 256, 32), stats))
    count = {k: sum(x.size for x in jax.tree.leaves(v)) for k, v in params.items()}
    assert count["vision"] + count["features"] == 11_215_904
    assert count["unet"] == 252_647_047


@pytest.mark.parametrize(
    ("changes", "hint"),
    [
        ({"sampler": "dddim"}, "did you mean 'ddim'"),
        ({"padding": "samples"}, "did you mean 'sample'"),
        ({"chunk": 5}, "chunk 5 is not a multiple of 2"),
        ({"channels": (8, 12)}, "not multiples of groups 8"),
        ({"sample_steps": 101}, "sample_steps must be 1 to"),
        ({"obs_steps": 4}, "obs_steps must be 1 to 3"),
        ({"temperature": -1.0}, "temperature must be at least 0, got -1"),
    ],
)
def test_what_cannot_work_is_refused(changes, hint):
    with pytest.raises(ConfigError, match=hint):
        tiny(**changes)


def test_a_crop_must_fit():
    with pytest.raises(ConfigError, match=r"20 pixels does not fit in 16x16"):
        make(tiny(crop=20))
