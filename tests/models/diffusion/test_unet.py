"""Parts of the U-Net: the embedding of steps, convolutions over time, the activation."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import places
import pytest
from flax import nnx

from jaxcam.models.diffusion.unet import Conv1d, Upsample, mish, step_embedding

GOLDEN = json.loads((places.GOLDEN / "schedules.json").read_text())


def test_step_embedding_is_the_golden_one():
    got = step_embedding(jnp.array([50]), 128)[0]
    for channel, value in GOLDEN["dp_time_emb_d128_t50"].items():
        assert float(got[int(channel)]) == pytest.approx(value, abs=1e-5)


def test_convolutions_over_time_are_those_of_xla():
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
