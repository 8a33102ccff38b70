"""Layers of one shape, run one after another."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from jaxcam.models.smolvla.stack import through


def test_rematerialisation_changes_no_number():
    blocks = [nnx.Linear(4, 4, rngs=nnx.Rngs(i)) for i in range(3)]

    def run(x, *, remat):
        def step(layer, x, item):
            return jax.nn.silu(layer(x)) + item, x.sum()

        x, sums = through(blocks, step, x, jnp.arange(3.0), remat=remat)
        return x.sum() + (sums * jnp.arange(3.0)).sum()

    x = jnp.ones((2, 4))
    for function in (run, jax.grad(run)):
        np.testing.assert_allclose(function(x, remat=True), function(x, remat=False), 1e-5, 1e-6)
    programs = [str(jax.make_jaxpr(partial(run, remat=remat))(x)) for remat in (False, True)]
    assert ["prevent_cse" in program for program in programs] == [False, True]
