"""Our kernel gradients are XLA's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcam.models.convolution import convolve


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
    of_kernel = jax.vjp(lambda k: convolve(x, k, (1, 1), pads), k)[1](above)[0]
    wide = x.astype(jnp.float32), k.astype(jnp.float32), above.astype(jnp.float32)
    exact = jax.vjp(lambda k: plain(wide[0], k, (1, 1), pads), wide[1])[1](wide[2])[0]
    assert of_kernel.dtype == jnp.bfloat16
    np.testing.assert_allclose(
        of_kernel.astype(jnp.float32), exact, rtol=2**-8, atol=1e-3 * abs(exact).max()
    )


def test_it_maps_over_batches():
    x, k = numbers(0, 2, 3, 8, 8, 4), numbers(1, 2, 3, 3, 4, 4)

    def slope(x, k):
        return jax.grad(lambda k: (convolve(x, k, (1, 1), [(1, 1), (1, 1)]) ** 2).sum())(k)

    together = jax.vmap(slope)(x, k)
    one_by_one = jnp.stack([slope(x[i], k[i]) for i in range(2)])
    np.testing.assert_allclose(together, one_by_one, rtol=1e-4, atol=1e-3)
