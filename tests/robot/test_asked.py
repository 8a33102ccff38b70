"""A policy in batches of one size: the same chunk bit for bit, whatever is computed with it."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from policy_inputs import make_batch, make_plain, start, tiny
from served_runs import linear
from tiny_training import SPEC

from jaxcam.evaluation.evaluator import Acting, Candidate
from jaxcam.robot.asked import AskedPolicy, Question, blank, observation_of

WIDTH = 4


def rows_of(batch, names=("image", "K", "base_from_camera", "proprio")):
    count = len(batch["proprio"])
    return [{name: batch[name][i] for name in names} for i in range(count)]


def observations(count):
    rng = np.random.default_rng(0)
    size = (SPEC.views, SPEC.height, SPEC.width, 3)
    return [
        blank(SPEC) | {
            "image": rng.integers(0, 256, size, np.uint8),
            "proprio": rng.normal(size=SPEC.proprio_dim).astype(np.float32),
        }
        for _ in range(count)
    ]  # fmt: skip


@pytest.fixture(scope="module")
def act():
    """A small ACT in batches of four, and what the rows of its batch are."""
    network = make_plain(tiny("laptop", "keypoints"))
    params = start(network)
    batch = make_batch(batch=WIDTH)
    names = ("image", "K", "base_from_camera", "proprio")
    local = jax.jit(network.act)(params, {n: batch[n] for n in names}, jax.random.key(5))
    asked = AskedPolicy(Candidate(network, params, None, 0), 0, WIDTH)  # pyright: ignore
    return asked, rows_of(batch), np.asarray(local)


@pytest.mark.parametrize("company", [(0, 1, 2, 3), (3, 1, 0, 2), (2,), (1, 3), (0, 2)])
def test_chunks_are_those_of_act_bit_for_bit_in_any_company(act, company):
    asked, rows, local = act
    assert not asked.draws
    chunks = asked.chunks([Question(rows[i], call=i, row=i) for i in company])
    for i, chunk in zip(company, chunks, strict=True):
        assert chunk.tobytes() == local[i].tobytes()


def test_a_policy_without_chance_takes_one_of_each_row_whatever_the_call():
    asked, [row] = AskedPolicy(linear(noise=False), 0, WIDTH), observations(1)
    rows = (0, 2, 0, 1, 3, 2)
    requests = [Question(row, call=i, row=r) for i, r in enumerate(rows)]
    assert asked.together(requests) == [0, 1, 3, 4]


def test_cameras_with_lenses_are_computed_apart_from_pinholes():
    asked, [plain] = AskedPolicy(linear(noise=False), 0, WIDTH), observations(1)
    bent = plain | {"distortion": np.full((SPEC.views, 9), 0.1, np.float32)}
    for some in ((plain, bent, plain), (bent, plain, bent)):
        assert asked.together([Question(obs, row=i) for i, obs in enumerate(some)]) == [0, 2]
    np.testing.assert_array_equal(*map(asked.chunks, ([Question(bent)], [Question(plain)])))


def test_chance_is_that_of_rollouts_by_call_and_row():
    candidate, rows = linear(noise=True), observations(WIDTH)
    asked = AskedPolicy(candidate, 7, WIDTH)
    assert asked.draws
    batch = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
    acting, everyone = Acting(candidate.policy.act), np.ones(WIDTH, bool)
    for call in (0, 3):
        rollouts = np.asarray(
            acting(candidate.params, jax.random.key(7), batch, jnp.int32(call), everyone)
        )
        together = asked.chunks([Question(rows[i], call, i) for i in (2, 0)])
        for i, chunk in zip((2, 0), together, strict=True):
            assert chunk.tobytes() == rollouts[i].tobytes()


def test_chance_is_shared_by_one_call_only_and_a_row_is_one_requests():
    asked, [row] = AskedPolicy(linear(noise=True), 0, WIDTH), observations(1)
    requests = [Question(row, *x) for x in [(0, 0), (1, 1), (0, 2), (0, 0), (0, 3)]]
    assert asked.together(requests) == [0, 2, 4]


def test_moments_get_an_axis_where_there_are_several():
    one = blank(SPEC)
    assert observation_of([one])["image"].shape == (SPEC.views, SPEC.height, SPEC.width, 3)
    several = blank(replace(SPEC, obs_steps=2), lens=True)
    assert several["image"].shape == (2, SPEC.views, SPEC.height, SPEC.width, 3)
    assert several["distortion"].shape == (2, SPEC.views, 9)
