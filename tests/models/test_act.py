"""ACT: shapes, loss, normalisation, sizes, and that its functions are pure."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from policy_inputs import (
    ACTION,
    CHUNK,
    CONDITIONINGS,
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

from jaxcam.errors import ConfigError
from jaxcam.models import ACT_PRESETS, PolicySpec, make_policy
from jaxcam.models.act.transformer import sine_table
from jaxcam.models.conditioning import with_conditioning
from jaxcam.models.layers import dropout


def count(tree):
    return sum(x.size for x in jax.tree.leaves(tree))


@pytest.mark.parametrize("conditioning", CONDITIONINGS)
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


def test_paper_has_the_parameters_of_the_authors_network():
    spec = PolicySpec(7, 7, 1, 256, 256, 30)
    stats = {f"action_{k}": np.ones(7) for k in ("mean", "std")}
    stats |= {f"proprio_{k}": np.ones(7) for k in ("mean", "std")}
    late = ACT_PRESETS["paper"]
    plain = replace(late, conditioning="none", twin_of="none")
    late, plain = (shapes(make_policy(c, spec, stats)) for c in (late, plain))
    assert count(late["vision"]["image"]) == 11_166_912
    assert count(late["vision"]["rays"]) == 3_926_400
    assert count(late) == 45_169_288
    assert count(plain) == 40_980_744
    assert count(late) - count(plain) == 3_926_400 + 512 * 512
    assert {x.dtype for x in jax.tree.leaves(late)} == {jnp.dtype("float32")}


def test_laptop_is_small():
    spec = PolicySpec(7, 7, 1, 84, 84, 16)
    stats = {f"{a}_{k}": np.ones(7) for a in ("action", "proprio") for k in ("mean", "std")}
    assert count(shapes(make_policy(ACT_PRESETS["laptop"], spec, stats))) < 1_000_000


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


def test_parameters_are_nested_dicts_with_string_keys():
    params = shapes(make(tiny("paper", "late")))
    for path, _ in jax.tree_util.tree_flatten_with_path(params)[0]:
        assert all(isinstance(step, jax.tree_util.DictKey) for step in path)
        assert all(isinstance(step.key, str) for step in path)


def test_none_keeps_the_network_it_is_compared_with():
    laptop = ACT_PRESETS["laptop"]
    twin = with_conditioning(laptop, "none")
    assert (twin.conditioning, twin.network) == ("none", laptop.network)
    assert with_conditioning(with_conditioning(laptop, "late"), "none").network == "late"
    assert with_conditioning(twin, "early").network == "early"


def test_weights_start_as_in_pytorch():
    policy = make(tiny("paper", "late"))
    params = policy.init(jax.random.key(0))
    head, latent = params["head"], params["latent"]

    def largest(layer):
        return float(jnp.abs(layer["kernel"]).max())

    def near(bound):
        return pytest.approx(bound, rel=0.15)

    assert largest(head["action"]) == near(16**-0.5)  # PyTorch's default.
    attention = head["encoder"]["layers"]["0"]["attention"]
    assert largest(attention["query"]) == near((6 / (4 * 16)) ** 0.5)  # Packed Xavier.
    assert largest(attention["out"]) == near((6 / (2 * 16)) ** 0.5)
    assert largest(latent["encoder"]["layers"]["0"]["attention"]["out"]) == near(16**-0.5)
    convs = params["vision"]["image"]["convs"]
    assert largest(convs["0"]) == near((9 * 8) ** -0.5)
    assert float(head["image_position"].std()) == near(1.0)


def test_sine_table_matches_the_golden_values():
    table = sine_table(32, 512)
    expected = [0.84147098, 0.54030231, 0.82185619, 0.56969501, 0.8019618, 0.59737533]
    np.testing.assert_allclose(table[1, :6], expected, atol=1e-6)
    np.testing.assert_allclose(table[1, -2:], [1.03663e-4, 0.99999999], rtol=1e-4)


def test_what_does_not_go_together_is_refused():
    config, stats = tiny("laptop", "keypoints"), make_stats()
    with pytest.raises(ConfigError, match="predicts 4 actions but the data has chunks of 9"):
        make_policy(config, PolicySpec(ACTION, PROPRIO, 1, 16, 16, 9), stats)
    with pytest.raises(ConfigError, match="Statistics of proprio"):
        make_policy(config, PolicySpec(ACTION, 2, 1, 16, 16, CHUNK), stats)
    with pytest.raises(ConfigError, match="not a multiple of heads"):
        tiny("paper", "late", width=17)
    with pytest.raises(ConfigError, match="did you mean 'mlp'"):
        tiny("laptop", "late", head="mpl")


def test_dropout_drops_its_share_and_keeps_the_mean():
    x = jnp.ones((500, 1000))
    y = dropout(x, 0.1, jax.random.key(0))
    assert float((y == 0).mean()) == pytest.approx(0.1, abs=3e-3)
    assert float(y.mean()) == pytest.approx(1, abs=3e-3)
    assert dropout(x, 0.1, None) is x
