"""The update: it learns, resumes bit-exactly, skips non-finite steps, and follows its schedule."""

import dataclasses
import json
import math

import jax
import jax.numpy as jnp
import numpy as np
import optax
import places
import pytest

from jaxcam.config.train import TrainConfig
from jaxcam.errors import DivergedError
from jaxcam.runs.identity import resolve
from jaxcam.training.state import (
    Stream,
    Update,
    check_finite,
    ema_decay,
    init_state,
    make_optimizer,
    make_schedule,
    make_train_chunk,
    stream_key,
)

CONFIG = resolve(TrainConfig(steps=40, lr=0.1, warmup=4), accelerator=False)
ROOT = jax.random.key(CONFIG.seed)
GOLDEN = json.loads((places.GOLDEN / "schedules.json").read_text())


def init(key):
    return {"w": jax.random.normal(key, (3, 2)), "deep": {0: {"b": jnp.zeros(2)}}}


def loss(params, batch, key):
    noise = 0.01 * jax.random.normal(key, batch["x"].shape)
    out = (batch["x"] + noise) @ params["w"] + params["deep"][0]["b"]
    return jnp.mean((out - batch["y"]) ** 2), {"mean_out": out.mean()}


def batches(steps):
    rng = [np.random.default_rng(s) for s in steps]
    x = np.stack([r.normal(size=(8, 3)).astype(np.float32) for r in rng])
    return {"x": x, "y": x[..., :2]}


def build(*, ema=0.0, augment=None, loss=loss):
    tx = make_optimizer(CONFIG)
    return init_state(init, tx, ROOT, ema=ema > 0), make_train_chunk(
        Update(loss, tx, augment=augment, ema=ema)
    )


def assert_equal_trees(a, b):
    jax.tree.map(np.testing.assert_array_equal, a, b)


def test_learns_and_counts():
    state, chunk = build()
    state, metrics = chunk(state, batches(range(40)), ROOT)
    assert int(state.step) == 40
    assert metrics["loss"].shape == (40,)
    assert set(metrics) == {"loss", "grad_norm", "skipped", "mean_out"}
    assert metrics["loss"][-1] < 0.1 * metrics["loss"][0]
    assert metrics["skipped"].sum() == 0


@pytest.mark.parametrize("width", [1, 3])
def test_six_updates_equal_three_and_three(width):
    def run(state, first, last):
        for s in range(first, last, width):
            state, _ = chunk(state, batches(range(s, s + width)), ROOT)
        return state

    state, chunk = build(ema=0.9)
    whole = run(state, 0, 6)
    half = jax.tree.map(np.asarray, run(build(ema=0.9)[0], 0, 3))
    resumed = run(jax.tree.map(jnp.asarray, half), 3, 6)
    assert_equal_trees(whole, resumed)


def test_chunk_width_changes_only_last_digits():
    state, chunk = build()
    one, _ = chunk(state, batches(range(4)), ROOT)
    state, _ = build()
    for s in range(4):
        state, _ = chunk(state, batches([s]), ROOT)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5), one.params, state.params)


def test_state_is_donated_and_compiled_once():
    traces = []

    def counted(params, batch, key):
        traces.append(1)
        return loss(params, batch, key)

    state, chunk = build(ema=0.5, loss=counted)
    first = state
    for s in range(3):
        state, _ = chunk(state, batches([s]), ROOT)
    assert len(traces) == 1
    assert first.params["w"].is_deleted()


@pytest.mark.parametrize("width", [1, 5])
def test_non_finite_update_is_skipped(width):
    data = batches(range(5))
    data["x"][2, 0, 0] = np.nan
    state, chunk = build(ema=0.9)
    before = None
    for s in range(0, 5, width):
        if s == 2:
            before = jax.tree.map(np.asarray, (state.params, state.opt, state.ema))
        state, metrics = chunk(state, jax.tree.map(lambda x, s=s: x[s : s + width], data), ROOT)
        if s == 2:
            assert_equal_trees(before, (state.params, state.opt, state.ema))
            assert int(state.bad_steps) == 1
            assert metrics["skipped"].tolist() == [1.0]
    assert int(state.step) == 5
    assert int(state.bad_steps) == 0
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(state))


def test_diverged_after_ten_bad_updates_in_a_row():
    data = batches(range(10))
    data["y"][:] = np.inf
    state, chunk = build()
    state, _ = chunk(state, jax.tree.map(lambda x: x[:9], data), ROOT)
    check_finite(state)
    state, _ = chunk(state, jax.tree.map(lambda x: x[9:], data), ROOT)
    with pytest.raises(DivergedError, match="10 updates in a row, up to update 10"):
        check_finite(state)


def test_augment_sees_a_new_key_each_step():
    def augment(batch, key):
        return {**batch, "x": batch["x"] * 0 + jax.random.uniform(key)}

    def reading(params, batch, key):
        value, _ = loss(params, batch, key)
        return value, {"drawn": batch["x"][0, 0]}

    state, chunk = build(augment=augment, loss=reading)
    _, metrics = chunk(state, batches(range(4)), ROOT)
    expected = [jax.random.uniform(stream_key(ROOT, Stream.CROP, s)) for s in range(4)]
    np.testing.assert_allclose(metrics["drawn"], expected, rtol=1e-6)
    assert len(set(np.asarray(metrics["drawn"]).tolist())) == 4


def test_crop_and_dropout_of_one_step_are_drawn_apart():
    """With one key for both, what is cut off would tell what is dropped."""

    def augment(batch, key):
        return {**batch, "x": batch["x"] * 0 + jax.random.uniform(key)}

    def reading(params, batch, key):
        value, _ = loss(params, batch, key)
        return value, {"cropped": batch["x"][0, 0], "dropped": jax.random.uniform(key)}

    state, chunk = build(augment=augment, loss=reading)
    _, metrics = chunk(state, batches(range(4)), ROOT)
    numbers = np.concatenate([metrics["cropped"], metrics["dropped"]])
    assert len(set(numbers.tolist())) == 8


def test_ema_follows_and_off_costs_nothing():
    state, chunk = build(ema=0.9)
    start = np.asarray(state.params["w"])
    state, _ = chunk(state, batches([0]), ROOT)
    np.testing.assert_allclose(
        state.ema["w"], 0.9 * start + 0.1 * np.asarray(state.params["w"]), rtol=1e-6
    )
    assert state.eval_params is state.ema
    state, _ = build()
    assert state.ema is None
    assert len(jax.tree.leaves(state)) == 2 + 2 + len(jax.tree.leaves(state.opt))


def test_ema_decay_rises_as_that_of_diffusion_policy():
    for step, decay in GOLDEN["ema_decay_power0.75"].items():
        assert float(ema_decay(jnp.int32(int(step)), 0.9999, 0.75)) == pytest.approx(
            decay, abs=1e-6
        )


def test_ema_that_rises_starts_as_the_parameters():
    tx = make_optimizer(CONFIG)
    chunk = make_train_chunk(Update(loss, tx, ema=0.9, ema_power=0.75))
    state, _ = chunk(init_state(init, tx, ROOT, ema=True), batches([0]), ROOT)
    assert_equal_trees(state.ema, state.params)


def test_frozen_parameters_stay_and_l2_is_not_decoupled():
    params = {"w": jnp.ones(2), "frozen_scale": jnp.ones(2)}
    grads = {"w": jnp.ones(2), "frozen_scale": jnp.zeros(2)}
    moved = {}
    for kind in ("adamw", "adam"):
        tx = make_optimizer(dataclasses.replace(CONFIG, optimizer=kind, weight_decay=0.5))
        updates, _ = tx.update(grads, tx.init(params), params)
        assert (updates["frozen_scale"] == 0).all()
        moved[kind] = float(updates["w"][0])
    # Adam's first step has size 1 whatever is added to the gradient.
    assert moved["adamw"] == pytest.approx(1.5 * moved["adam"], rel=1e-3)


def test_seeds_can_be_vmapped():
    tx = make_optimizer(CONFIG)
    chunk = make_train_chunk(Update(loss, tx))
    roots = jax.vmap(jax.random.key)(jnp.arange(3))
    states = jax.vmap(lambda r: init_state(init, tx, r))(roots)
    both, _ = jax.vmap(chunk, in_axes=(0, None, 0))(states, batches(range(2)), roots)
    single, _ = chunk(init_state(init, tx, roots[1]), batches(range(2)), roots[1])
    np.testing.assert_allclose(both.params["w"][1], single.params["w"], rtol=1e-5)


def test_clipping_bounds_the_first_moment():
    state, chunk = build()
    data = batches([0])
    data["y"] = data["y"] + 1e4
    state, metrics = chunk(state, data, ROOT)
    assert metrics["grad_norm"][0] > 100
    mu = optax.tree.get(state.opt, "mu")
    assert optax.tree.norm(mu) <= 0.1 * CONFIG.clip_norm * 1.001


def test_schedules():
    cosine = make_schedule(CONFIG)
    assert 0 < cosine(0) < cosine(2) < cosine(4) == pytest.approx(0.1)
    assert cosine(40) == pytest.approx(0, abs=1e-9)
    paper = resolve(TrainConfig(preset="paper"), accelerator=True)
    for step in (0, 1, 59_999):
        assert make_schedule(paper)(step) == pytest.approx(2e-5)
    late = make_schedule(dataclasses.replace(paper, warmup=10))
    assert late(0) < late(5) < late(10) == pytest.approx(2e-5)


def test_the_cosine_of_lerobots_smolvla_begins_with_the_first_update():
    config = resolve(TrainConfig(policy="smolvla", preset="lerobot"), accelerator=True)
    rate, least, peak = make_schedule(config), 2.5e-6, 1e-4
    assert rate(0) == pytest.approx(peak / 1001, rel=1e-3)  # float32
    assert rate(500) == pytest.approx(peak * (1 / 1001 + (1 - 1 / 1001) / 2))
    for step in (1000, 7500, 15_000, 30_000):
        cosine = (1 + math.cos(math.pi * step / 30_000)) / 2
        assert rate(step) == pytest.approx(least + (peak - least) * cosine, rel=1e-5)


def test_streams_do_not_collide():
    keys = {tuple(jax.random.key_data(stream_key(ROOT, s, i)).tolist()) for s in Stream
            for i in range(20)}  # fmt: skip
    assert len(keys) == 20 * len(Stream)
