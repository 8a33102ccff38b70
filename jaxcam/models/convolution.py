"""A convolution whose kernel gets its gradient fast on a processor, too.

XLA takes that gradient as a convolution with a window as large as the picture, which a processor
computes several times slower than the convolution itself, and twenty times from 28 x 28 pixels on
(docs/policies.md has what was measured). Here it is some matrix products for each picture, while
the cache holds that picture.
"""

import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

ROWS = 512
"""Pixels that matrix products have at least: where pictures have fewer, of several pictures."""
USUAL = None, 1, (1, 1)
"""Values of options that change nothing."""
LAYOUT = "NHWC", "HWIO", "NHWC"
"""Of pictures, kernels, and pictures that come out."""

Pads = tuple[tuple[int, int], ...]


def convolve(
    x: jax.Array, kernel: jax.Array, strides: tuple[int, ...], padding: Any, **options: Any
) -> jax.Array:
    """What `flax.nnx.Conv` calls to convolve pictures.

    Args:
        x: Pictures [B, H, W, I].
        kernel: Weights [h, w, I, O].
        strides: Down and to the right (pixels).
        padding: Pixels before and after, for both directions.
        options: Others that `jax.lax.conv_general_dilated` has; where one is not as usual, such as
            another layout than this, all is XLA's.

    Returns:
        Pictures [B, H', W', O].
    """
    layout = options.setdefault("dimension_numbers", LAYOUT)
    numbers = functools.partial(lax.conv_dimension_numbers, x.shape, kernel.shape)
    is_usual = x.ndim == 4 and numbers(layout) == numbers(LAYOUT)
    is_usual &= all(v in USUAL for k, v in options.items() if k != "dimension_numbers")
    if not is_usual or isinstance(padding, str):
        return lax.conv_general_dilated(x, kernel, strides, padding, **options)
    return _convolve(x, kernel, tuple(strides), tuple((a, b) for a, b in padding))


@functools.partial(jax.custom_vjp, nondiff_argnums=(2, 3))
def _convolve(x: jax.Array, kernel: jax.Array, strides: tuple[int, ...], pads: Pads) -> jax.Array:
    return _plain(x, kernel, strides, pads)


def _plain(x: jax.Array, kernel: jax.Array, strides: tuple[int, ...], pads: Pads) -> jax.Array:
    return lax.conv_general_dilated(x, kernel, strides, pads, dimension_numbers=LAYOUT)


def _forward(
    x: jax.Array, kernel: jax.Array, strides: tuple[int, ...], pads: Pads
) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    return _plain(x, kernel, strides, pads), (x, kernel)


def _backward(
    strides: tuple[int, ...], pads: Pads, saved: tuple[jax.Array, jax.Array], gradient: jax.Array
) -> tuple[jax.Array, jax.Array]:
    x, kernel = saved
    plain = functools.partial(_plain, strides=strides, pads=pads)
    (of_x,) = jax.vjp(lambda x: plain(x, kernel), x)[1](gradient)

    def by_xla(x: jax.Array, gradient: jax.Array) -> jax.Array:
        return jax.vjp(lambda k: plain(x, k), kernel)[1](gradient)[0]

    ours = functools.partial(_by_pictures, kernel=kernel.shape, strides=strides, pads=pads)
    is_odd = not min(gradient.shape + kernel.shape) or min(map(min, pads)) < 0
    # Pictures of several devices go together.
    cpu = ours if jax.device_count() == 1 and not is_odd else by_xla
    return of_x, lax.platform_dependent(x, gradient, cpu=cpu, default=by_xla)


_convolve.defvjp(_forward, _backward)


def _by_pictures(
    x: jax.Array,
    gradient: jax.Array,
    *,
    kernel: tuple[int, ...],
    strides: tuple[int, ...],
    pads: Pads,
) -> jax.Array:
    """The kernel's gradient, a few pictures after the other."""
    (high, wide, d_in, d_out), (count, rows, columns, _) = kernel, gradient.shape
    down, right = strides
    sums = jnp.promote_types(x.dtype, jnp.float32)
    several = math.gcd(count, max(1, ROWS // max(1, rows * columns)))

    def add(total: jax.Array, part: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, None]:
        x, gradient = part
        x = jnp.pad(x, ((0, 0), *pads, (0, 0)))
        across = [x[:, :, j : j + (columns - 1) * right + 1 : right] for j in range(wide)]
        wider = jnp.concatenate(across, -1)
        gradient = gradient.reshape(-1, d_out)
        products = [
            jnp.matmul(
                wider[:, i : i + (rows - 1) * down + 1 : down].reshape(-1, wide * d_in).T,
                gradient,
                preferred_element_type=sums,
            )
            for i in range(high)
        ]
        return total + jnp.concatenate(products), None

    parts = jax.tree.map(lambda a: a.reshape(-1, several, *a.shape[1:]), (x, gradient))
    total, _ = lax.scan(add, jnp.zeros((high * wide * d_in, d_out), sums), parts)
    return total.reshape(kernel).astype(x.dtype)
