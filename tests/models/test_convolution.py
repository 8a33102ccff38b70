"""Our kernel gradients are XLA's."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from policy_inputs import make_batch, make_plain, shapes, tiny

from jaxcam.models import ACT_PRESETS
from jaxcam.models.convolution import convolve
from jaxcam.models.layers import conv


def plain(x, kernel, strides, padding):
    return jax.lax.conv_general_dilated(
        x, kernel, strides, padding, dimension_numbers=("NHWC", "HWIO", "NHWC")
    )


def numbers(seed, *shape):
    return jax.random.normal(jax.random.key(seed), shape)


@pytest.mark.parametrize(
    ("pictures", "kernel", "strides"),
    [
        ((3, 9, 7, 4), (3, 3, 4, 5), (1, 1)),
        ((4, 30, 22, 3), (3, 3, 3, 8), (1, 1)),
        ((5, 16, 13, 6), (7, 7, 6, 4), (2, 2)),
        ((1, 12, 12, 4), (1, 1, 4, 6), (2, 2)),
        ((6, 10, 12, 2), (2, 3, 2, 3), (1, 2)),
    ],
)
def test_gradients_are_those_of_xlas_convolution(pictures, kernel, strides):
    x, k = numbers(0, *pictures), numbers(1, *kernel)
    pads = [((n - 1) // 2, (n - 1) // 2) for n in kernel[:2]]
    expected, back = jax.vjp(lambda x, k: plain(x, k, strides, pads), x, k)
    got, ours = jax.jit(lambda x, k: jax.vjp(lambda x, k: convolve(x, k, strides, pads), x, k))(
        x, k
    )
    np.testing.assert_array_equal(got, expected)
    above = numbers(2, *expected.shape)
    for a, b in zip(ours(above), back(above), strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_allclose(a, b, atol=1e-5 * abs(b).max())


def test_half_precision_is_summed_in_full():
    x, k = (numbers(i, *s).astype(jnp.bfloat16) for i, s in ((0, (64, 8, 8, 4)), (1, (3, 3, 4, 4))))
    pads = [(1, 1), (1, 1)]
    above = jnp.ones((64, 8, 8, 4), jnp.bfloat16)
    of_kernel = jax.jit(lambda k: jax.vjp(lambda k: convolve(x, k, (1, 1), pads), k)[1](above)[0])(
        k
    )
    wide = x.astype(jnp.float32), k.astype(jnp.float32), above.astype(jnp.float32)
    exact = jax.vjp(lambda k: plain(wide[0], k, (1, 1), pads), wide[1])[1](wide[2])[0]
    assert of_kernel.dtype == jnp.bfloat16
    np.testing.assert_allclose(
        of_kernel.astype(jnp.float32), exact, rtol=2**-8, atol=1e-3 * abs(exact).max()
    )


@pytest.mark.parametrize(
    ("kernel", "options", "pads"),
    [
        ((3, 3, 4, 4), {"rhs_dilation": (2, 2)}, [(1, 1), (1, 1)]),
        ((3, 3, 2, 4), {"feature_group_count": 2}, [(1, 1), (1, 1)]),
        ((3, 3, 4, 4), {}, "SAME"),
        ((3, 3, 4, 4), {}, [(-1, 2), (0, 0)]),
        ((9, 3, 4, 4), {}, [(0, 0), (1, 1)]),  # no rows are left
        ((3, 3, 4, 0), {}, [(1, 1), (1, 1)]),
    ],
)
def test_what_is_unusual_is_xlas(kernel, options, pads):
    x, k = numbers(0, 2, 8, 8, 4), numbers(1, *kernel)
    options = {"dimension_numbers": ("NHWC", "HWIO", "NHWC"), **options}

    def slopes(convolution):
        out, back = jax.vjp(lambda x, k: convolution(x, k, (1, 1), pads, **options), x, k)
        return out, *back(jnp.ones_like(out))

    for got, expected in zip(slopes(convolve), slopes(jax.lax.conv_general_dilated), strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-5, atol=1e-5)


def test_a_layout_that_fits_by_its_shape_alone_is_not_taken_for_ours():
    x, k, pads = numbers(0, 4, 4, 4, 4), numbers(1, 4, 4, 4, 4), [(1, 1), (1, 1)]
    layout = {"dimension_numbers": ("NCHW", "OIHW", "NCHW")}
    expected = jax.lax.conv_general_dilated(x, k, (1, 1), pads, **layout)
    np.testing.assert_allclose(convolve(x, k, (1, 1), pads, **layout), expected, atol=1e-5)


def test_layers_have_our_gradients():
    layer = conv(4, 6, 3, rngs=nnx.Rngs(0), dtype=jnp.float32)
    assert "custom_vjp" in str(jax.make_jaxpr(layer)(numbers(0, 2, 8, 8, 4)))


def test_it_maps_over_batches():
    x, k = numbers(0, 2, 3, 8, 8, 4), numbers(1, 2, 3, 3, 4, 4)

    def slope(x, k):
        return jax.grad(lambda k: (convolve(x, k, (1, 1), [(1, 1), (1, 1)]) ** 2).sum())(k)

    together = jax.vmap(slope)(x, k)
    one_by_one = jnp.stack([slope(x[i], k[i]) for i in range(2)])
    np.testing.assert_allclose(together, one_by_one, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("preset", ["laptop", "paper"])
def test_policies_learn_in_half_precision(preset):
    """Shapes alone, as an update is traced on a CPU."""
    way = ACT_PRESETS[preset].conditioning
    policy = make_plain(tiny(preset, way, compute_dtype="bfloat16"))
    params = shapes(policy)

    def loss(params):
        return policy.loss(params, make_batch(), jax.random.key(0))[0]

    slopes = jax.eval_shape(jax.jit(jax.grad(loss)), params)
    assert jax.tree.map(lambda x: (x.shape, x.dtype), slopes) == jax.tree.map(
        lambda x: (x.shape, x.dtype), params
    )


def test_on_several_devices_each_sums_its_own_pictures():
    """A loop over a batch that several devices share would bring all pictures to all of them."""
    code = """
import jax, jax.numpy as jnp
from jax.sharding import Mesh, NamedSharding, PartitionSpec as P
from jaxcam.models.convolution import convolve
mesh = Mesh(jax.devices(), "data")
apart = jax.device_put(jnp.ones((8, 8, 8, 4)), NamedSharding(mesh, P("data")))
kernel = jnp.ones((3, 3, 4, 4))
take = jax.jit(jax.grad(lambda k, x: (convolve(x, k, (1, 1), [(1, 1)] * 2) ** 2).sum()))
text = take.lower(kernel, apart).compile().as_text()
assert len(jax.devices()) == 2
assert "all-gather" not in text and "all-reduce" in text
"""
    flags = "--xla_force_host_platform_device_count=2"
    env = os.environ | {"XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
    ran = subprocess.run([sys.executable, "-c", code], check=False, env=env, stderr=subprocess.PIPE)
    assert ran.returncode == 0, ran.stderr.decode()
