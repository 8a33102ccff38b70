"""SmolVLA as functions: what it trains, listens to and leaves alone."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from policy_inputs import jit, make_batch, make_stats, moved, shapes, start

from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.models import PolicySpec, make_policy
from jaxcam.models.conditioning import with_conditioning
from jaxcam.models.smolvla.config import SMOLVLA_PRESETS
from jaxcam.models.smolvla.prompt import with_prompts
from jaxcam.runs.identity import resolve
from jaxcam.training.state import make_optimizer

TINY = replace(
    SMOLVLA_PRESETS["tiny"], chunk=4, image_size=32, layers=1, vision_layers=1, remat=False
)
SPEC = PolicySpec(3, 5, 1, 32, 32, 4)


@cache
def policy(config=TINY):
    return make_policy(config, SPEC, make_stats())


@pytest.mark.parametrize(
    "changes", [{"attention": "joint"}, {"attention": "interleaved", "layers": 2, "remat": True}]
)
def test_trains(changes):
    config = replace(TINY, conditioning="none", twin_of="none", **changes)
    subject, batch = policy(config), make_batch(size=32)
    batch["is_pad"] = np.zeros((2, 4), bool)
    tx = optax.adam(3e-3)

    def step(carry, _):
        params, opt = carry
        (loss, _), grads = jax.value_and_grad(subject.loss, has_aux=True)(params, batch, None)
        updates, opt = tx.update(grads, opt)
        return (optax.apply_updates(params, updates), opt), loss

    params = jax.tree.map(jnp.asarray, start(subject))
    losses = jit(lambda c: jax.lax.scan(step, c, length=60)[1])((params, tx.init(params)))
    assert float(losses[-1]) < 0.3 * float(losses[0])


def test_expert_alone_is_trained():
    config = replace(TINY, train="expert", conditioning="none", twin_of="none")
    subject = policy(config)
    params = start(subject)
    grads = jit(jax.grad(lambda p: subject.loss(p, make_batch(size=32), None)[0]))(params)
    moved_parts = {k for k, v in grads.items() if float(optax.tree.norm(v)) > 0}
    assert moved_parts == params.keys() - {"vision", "connector", "embed", "text"}
    run = resolve(TrainConfig(policy="smolvla", preset="lerobot"), accelerator=False)
    tx = make_optimizer(run, subject.trained)
    state = jax.eval_shape(tx.init, params)
    size = {k: sum(x.size for x in jax.tree.leaves(v)) for k, v in params.items()}
    trained = sum(n for k, n in size.items() if k in moved_parts)
    assert sum(x.size for x in jax.tree.leaves(state)) == pytest.approx(2 * trained, abs=4)


@pytest.mark.parametrize(
    ("conditioning", "attention"),
    [("token", "joint"), ("late", "joint"), ("warp", "joint"), ("prope", "joint"),
     ("gta", "interleaved"), ("ray_rope", "joint"), ("ray_rope", "interleaved")],
)  # fmt: skip
def test_conditioned_policy_looks_at_the_cameras_and_its_twin_does_not(conditioning, attention):
    layers = 2 if attention == "interleaved" else TINY.layers
    config = with_conditioning(replace(TINY, attention=attention, layers=layers), conditioning)
    batch, key = make_batch(size=32), jax.random.key(1)
    subject, twin = policy(config), policy(with_conditioning(config, "none"))
    params = start(subject)
    assert jax.tree.map(jnp.shape, params) == jax.tree.map(jnp.shape, shapes(twin))
    act, blind = jit(subject.act), jit(twin.act)
    assert not np.allclose(act(params, batch, key), act(params, moved(batch), key))
    np.testing.assert_array_equal(blind(params, batch, key), blind(params, moved(batch), key))
    assert act(params, batch, key).shape == (2, 4, 3)


@pytest.mark.parametrize("conditioning", ["token", "early", "late", "keypoints"])
def test_an_own_tower_has_every_conditioning_and_any_shape(conditioning):
    """The preset for a laptop, with pictures that are no squares."""
    small = {"chunk": 4, "encoder_width": 4, "keypoints": 2, "width": 16, "layers": 1, "heads": 2,
             "kv_heads": 1, "head_dim": 8, "hidden": 16, "expert_width": 12,
             "expert_hidden": 16}  # fmt: skip
    laptop = with_prompts(replace(SMOLVLA_PRESETS["laptop"], **small), ("Lift the cube",))
    config = with_conditioning(laptop, conditioning)
    spec = PolicySpec(3, 5, 2, 24, 32, 4)
    subject, twin = (make_policy(c, spec, make_stats())
                     for c in (config, with_conditioning(config, "none")))  # fmt: skip
    params, rng = start(subject), np.random.default_rng(0)
    batch = {k: np.repeat(v, 2, 1) if k in ("K", "base_from_camera") else v
             for k, v in make_batch(size=32).items()}  # fmt: skip
    batch["image"] = rng.integers(0, 256, (2, 2, 24, 32, 3), dtype=np.uint8)
    assert jax.tree.map(jnp.shape, params) == jax.tree.map(jnp.shape, shapes(twin))
    act, blind, key = jit(subject.act), jit(twin.act), jax.random.key(1)
    assert not np.allclose(act(params, batch, key), act(params, moved(batch), key))
    np.testing.assert_array_equal(blind(params, batch, key), blind(params, moved(batch), key))
    loss, metrics = jit(lambda p: subject.loss(p, batch, None))(params)
    total = metrics["velocity"] + config.keyframe_weight * metrics["keyframe"]
    np.testing.assert_allclose(loss, total, rtol=1e-5)


def test_padded_actions_change_no_loss_of_the_paper():
    subject, batch = policy(replace(TINY)), make_batch(size=32)
    noisy = dict(batch, action=np.where(batch["is_pad"][..., None], 9.0, batch["action"]))
    loss, params = jit(lambda p, b: subject.loss(p, b, None)[0]), start(subject)
    assert float(loss(params, batch)) == pytest.approx(float(loss(params, noisy)), rel=1e-5)


def test_bfloat16_is_close_to_float32():
    config = replace(TINY, conditioning="none", twin_of="none")
    batch, params = make_batch(size=32), start(policy(config))
    losses = [
        float(jit(policy(replace(config, compute_dtype=d)).loss)(params, batch, None)[0])
        for d in ("float32", "bfloat16")
    ]
    assert losses[0] == pytest.approx(losses[1], rel=0.05)
    assert losses[0] != losses[1]


@pytest.mark.parametrize(
    ("changes", "sizes", "message"),
    [
        ({"tokens": ()}, {}, "tokenizer.json"),
        ({}, {"width": 64}, "square images, got 32x64"),
        ({"state_width": 4}, {}, "has 5 numbers, SmolVLA takes 4"),
        ({"action_width": 2}, {}, "have 3 numbers, SmolVLA predicts 2"),
        ({"chunk": 5}, {}, "predicts 5 actions"),
        ({}, {"height": 96, "width": 96}, "ray-map of 3x3 cells does not fit 4x4"),
    ],
)
def test_sizes_that_do_not_fit(changes, sizes, message):
    with pytest.raises(ConfigError, match=message):
        make_policy(replace(TINY, **changes), replace(SPEC, **sizes), make_stats())


@pytest.mark.parametrize(
    "changes",
    [
        {"attention": "joint", "mask": "causal"},
        {"attention": "interleaved", "mask": "blocks", "layers": 2},
    ],
)
def test_each_sample_is_told_its_own_prompt(changes):
    """One policy of two prompts is two policies of one, whatever fills the shorter one up."""
    prompts = ((1, 2), (3, 4, 5, 6, 7))
    config = replace(TINY, conditioning="none", twin_of="none", **changes)
    both = make_policy(
        replace(config, tokens=prompts[0], other_tokens=prompts[1:]), SPEC, make_stats()
    )
    params = start(both)
    obs = {
        k: v for k, v in make_batch(size=32).items() if k not in ("action", "is_pad", "keyframe")
    }
    act = jit(both.act)
    together = act(params, obs | {"instruction": np.array([0, 1], np.int32)}, None)
    each = []
    for i, tokens in enumerate(prompts):
        one = make_policy(replace(config, tokens=tokens), SPEC, make_stats())
        each.append(jit(one.act)(params, obs, None)[i])
    np.testing.assert_allclose(together, np.stack(each), atol=1e-5)
    assert np.abs(each[0] - act(params, obs, None)[0]).max() < 1e-5  # the first where nobody says
    other = act(params, obs | {"instruction": np.array([1, 0], np.int32)}, None)
    assert np.abs(other - together).max() > 1e-3
