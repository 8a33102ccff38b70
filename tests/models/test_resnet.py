"""Parts of the image encoders against what they are defined by."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx

from jaxcam.models.resnet import FROZEN_SCALE, NORMS, make_norm, max_pool

X = np.random.default_rng(0).normal(size=(2, 7, 6, 32)).astype(np.float32)


def test_the_pool_is_the_maximum_of_three_by_three_with_stride_two():
    padded = np.pad(X, ((0, 0), (1, 1), (1, 1), (0, 0)), constant_values=-np.inf)
    expected = [
        [padded[:, 2 * i : 2 * i + 3, 2 * j : 2 * j + 3].max((1, 2)) for j in range(3)]
        for i in range(4)
    ]
    np.testing.assert_array_equal(max_pool(jnp.asarray(X)), np.moveaxis(expected, 2, 0))


@pytest.mark.parametrize("kind", NORMS)
def test_norms_are_frozen_or_of_groups_of_sixteen_channels(kind):
    norm = make_norm(kind, 32, rngs=nnx.Rngs(0), dtype=jnp.float32)
    expected = X * FROZEN_SCALE
    if kind == "group":
        grouped = X.reshape(2, 7, 6, 2, 16)
        mean, var = (f(grouped, axis=(1, 2, 4), keepdims=True) for f in (np.mean, np.var))
        expected = ((grouped - mean) / np.sqrt(var + 1e-5)).reshape(X.shape)
    np.testing.assert_allclose(norm(jnp.asarray(X)), expected, rtol=1e-4, atol=1e-5)


def test_nobody_trains_a_frozen_norm():
    norm = make_norm("frozen", 32, rngs=nnx.Rngs(0), dtype=jnp.float32)
    graph, state = nnx.split(norm)
    grads = jax.grad(lambda state: nnx.merge(graph, state)(X).sum())(state)
    assert not any(np.any(g) for g in jax.tree.leaves(grads))
