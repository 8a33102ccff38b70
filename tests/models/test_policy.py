"""Policies as functions of dicts of arrays."""

import itertools

import jax
import numpy as np
import pytest
from flax import nnx
from policy_inputs import jit, make, make_plain, shapes, tiny

from jaxcam.models.policy import pure

KEY = jax.random.key(4)


class Drawn(nnx.Module):
    """Keys as those that layers draw their weights with."""

    def __init__(self, rngs):
        keys = [rngs.params(), rngs(), rngs.fork().params(), rngs.params()]
        self.keys = nnx.Param(jax.numpy.stack([jax.random.key_data(key) for key in keys]))


def test_parameters_are_nested_dicts_with_string_keys():
    params = shapes(make(tiny("paper", "late")))
    for path, _ in jax.tree_util.tree_flatten_with_path(params)[0]:
        assert all(isinstance(step, jax.tree_util.DictKey) for step in path)
        assert all(isinstance(step.key, str) for step in path)


@pytest.mark.parametrize("compiled", [lambda init: init, jax.jit])
def test_keys_are_flaxs_own(compiled):
    init, _ = pure(Drawn)
    expected = Drawn(nnx.Rngs(KEY)).keys[...]
    np.testing.assert_array_equal(compiled(init)(KEY)["keys"], expected)
    np.testing.assert_array_equal(compiled(jax.vmap(init))(KEY[None])["keys"][0], expected)


@pytest.mark.parametrize("preset", ["laptop", "attention"])
def test_no_two_weights_begin_alike(preset):
    params = jit(make_plain(tiny(preset, "late")).init)(KEY)
    drawn = [leaf for leaf in jax.tree.leaves(params) if len(np.unique(leaf)) > 2]
    assert len(drawn) > 5
    for a, b in itertools.combinations(drawn, 2):
        assert a.shape != b.shape or not np.allclose(a, b)
