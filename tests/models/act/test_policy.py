"""ACT as functions: shapes, loss, units, and that its functions are pure."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from policy_inputs import (
    ACTION,
    CHUNK,
    CONDITIONINGS,
    OUTSIDE_ATTENTION,
    PROPRIO,
    jit,
    make,
    make_batch,
    make_plain,
    make_stats,
    shapes,
    start,
    tiny,
)

from jaxcam.models import PolicySpec, make_policy


@pytest.mark.parametrize("conditioning", OUTSIDE_ATTENTION)
@pytest.mark.parametrize("views", [1, 2])
def test_laptop_shapes_and_gradients(conditioning, views):
    config, batch = tiny("laptop", conditioning), make_batch(views=views)
    policy = make_plain(config, views=views)
    params = start(make(config, views=views))
    assert jax.eval_shape(policy.act, params, batch, None).shape == (2, CHUNK, ACTION)
    loss_and_grad = jit(jax.value_and_grad(policy.loss, has_aux=True))
    (loss, metrics), grads = loss_and_grad(params, batch, jax.random.key(1))
    assert loss.shape == ()
    assert metrics["loss"] == loss
    assert all(np.isfinite(g).all() and (g != 0).any() for g in jax.tree.leaves(grads))


@pytest.mark.parametrize("conditioning", CONDITIONINGS)
def test_paper_shapes(conditioning):
    batch = make_batch(32, views=2)
    policy = make_plain(tiny("paper", conditioning, encoder="resnet18"), 32, views=2)
    actions = jax.eval_shape(policy.act, shapes(policy), batch, None)
    assert actions.shape == (2, CHUNK, ACTION)


def test_paper_gradients_are_finite_and_only_the_pad_head_gets_none():
    config = tiny("paper", "late")
    grad = jit(jax.grad(make_plain(config).loss, has_aux=True))
    grads, _ = grad(start(make(config)), make_batch(), jax.random.key(1))
    flat = jax.tree_util.tree_flatten_with_path(grads)[0]
    assert all(np.isfinite(g).all() for _, g in flat)
    untouched = {jax.tree_util.keystr(path) for path, g in flat if not (g != 0).any()}
    # Softmax ignores what is added to every key; the pose tokens are fed with zeros; and so is the
    # decoder, whose tokens are therefore all equal until the first cross-attention.
    assert any("is_pad" in name for name in untouched)
    allowed = ("is_pad", "['key']['bias']", "['pose']['kernel']", "['decoder']['self_attention']")
    allowed += ("['decoder']['norm1']", "['decoder']['norm2']['scale']")
    assert not [name for name in untouched if not any(a in name for a in allowed)]


@pytest.mark.parametrize("preset", ["paper", "laptop"])
def test_padded_steps_count_only_in_the_denominator(preset):
    policy, batch = make(tiny(preset, "late")), make_batch()
    params = start(policy)
    loss = policy.loss
    _, metrics = loss(params, batch, None)
    junk = batch | {"action": np.where(batch["is_pad"][..., None], 1e6, batch["action"])}
    for name, value in loss(params, junk, None)[1].items():
        assert float(value) == pytest.approx(float(metrics[name]), rel=1e-6)
    if preset == "laptop":
        error = np.abs(policy.act(params, batch, None) - batch["action"])
        error = (error / make_stats()["action_std"]) * ~batch["is_pad"][..., None]
        assert float(metrics["l1"]) == pytest.approx(error.sum() / error.size, rel=1e-5)


def test_kl_of_the_latent_enters_the_loss_with_its_weight():
    batch = make_batch()
    policies = [make(tiny("paper", "late", kl_weight=w)) for w in (1.0, 10.0)]
    params = start(policies[0])
    (one, metrics), (ten, _) = (p.loss(params, batch, None) for p in policies)
    assert metrics["kl"] > 0
    assert float(ten - one) == pytest.approx(9 * float(metrics["kl"]), rel=1e-5)


def test_noise_comes_only_from_the_key():
    policy, batch = make(tiny("paper", "late")), make_batch()
    params = start(policy)
    loss = policy.loss
    a, b, c = (loss(params, batch, jax.random.key(k))[0] for k in (1, 1, 2))
    assert a == b
    assert a != c
    assert loss(params, batch, None)[0] == loss(params, batch, None)[0]
    act = policy.act
    here = act(params, batch, jax.random.key(1))
    np.testing.assert_array_equal(here, act(params, batch, jax.random.key(2)))


def test_actions_are_in_raw_units_and_images_in_0_to_255():
    config, batch = tiny("laptop", "keypoints"), make_batch()
    spec = PolicySpec(ACTION, PROPRIO, 1, 16, 16, CHUNK)
    stats = make_stats()
    unit = stats | {"action_mean": np.zeros(ACTION), "action_std": np.ones(ACTION)}
    raw, normal = (make_policy(config, spec, s) for s in (stats, unit))
    params = start(make(config))
    actions = raw.act(params, batch, None)
    expected = normal.act(params, batch, None) * stats["action_std"] + stats["action_mean"]
    np.testing.assert_allclose(actions, expected, rtol=1e-6)
    floats = batch | {"image": batch["image"].astype(np.float16)}
    np.testing.assert_allclose(actions, raw.act(params, floats, None), rtol=1e-6)


def test_constant_dimensions_do_not_blow_up():
    config, batch = tiny("laptop", "none", drop_proprio=False), make_batch()
    stats = make_stats() | {"action_std": np.zeros(ACTION), "proprio_std": np.zeros(PROPRIO)}
    policy = make_policy(config, PolicySpec(ACTION, PROPRIO, 1, 16, 16, CHUNK), stats)
    params = start(make(config))
    actions = policy.act(params, batch, None)
    # Whatever the network says about an action that never varied, the mean is what comes out.
    np.testing.assert_allclose(actions - stats["action_mean"], 0, atol=1e-3)


@pytest.mark.parametrize("drop", [True, False])
def test_proprioception_is_dropped_when_asked(drop):
    policy, batch = make(tiny("laptop", "keypoints", drop_proprio=drop)), make_batch()
    params = start(policy)
    other = batch | {"proprio": batch["proprio"] + 1}
    same = np.array_equal(policy.act(params, batch, None), policy.act(params, other, None))
    assert same == drop


def test_seeds_are_a_batch_axis():
    config, batch = tiny("laptop", "keypoints"), make_batch()
    policy, plain = make(config), make_plain(config)
    keys = jax.random.split(jax.random.key(0), 2)
    many = jit(jax.vmap(plain.init))(keys)
    losses = jit(jax.vmap(lambda p: plain.loss(p, batch, None)[0]))(many)
    for key, one in zip(keys, losses, strict=True):
        alone, _ = policy.loss(policy.init(key), batch, None)
        assert float(one) == pytest.approx(float(alone), rel=1e-5)


@pytest.mark.parametrize("preset", ["paper", "laptop"])
def test_bfloat16_computes_nearly_the_same_and_keeps_float32_weights(preset):
    batch = make_batch()
    full, half = (make(tiny(preset, "late", compute_dtype=d)) for d in ("float32", "bfloat16"))
    params = start(half)
    assert {x.dtype for x in jax.tree.leaves(params)} == {jnp.dtype("float32")}
    a, b = full.act(params, batch, None), half.act(params, batch, None)
    assert b.dtype == jnp.float32
    assert not np.array_equal(a, b)
    np.testing.assert_allclose(a, b, atol=0.1)
