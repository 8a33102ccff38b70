"""NumPy in, NumPy out; JAX in, JAX out: helpers shared by the files of this package."""
# JAX's own annotations are partial.
# pyright: reportUnknownMemberType=false

from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxcam.errors import CameraError

Array = Any
"""A NumPy or JAX array, or anything `numpy.asarray` takes."""


def array_namespace(*arrays: Array) -> ModuleType:
    """`jax.numpy` when any array is JAX's (tracers included), else `numpy`."""
    return jnp if any(isinstance(a, jax.Array) for a in arrays) else np


def as_float(a: Array, xp: ModuleType) -> Array:
    """`a` as an array of `xp`; integers become float32, floats keep what precision `xp` has.

    Raises:
        CameraError: If a finite number is too large for the precision it would have.
    """
    given = a
    with np.errstate(over="ignore"):  # refused below
        a = xp.asarray(a)
    a = a if xp.issubdtype(a.dtype, xp.floating) else a.astype(xp.float32)
    if xp is jnp and not isinstance(given, jax.Array):
        given = np.asarray(given)
        largest = np.array(jnp.finfo(a.dtype).max, np.float64)
        if given.dtype.itemsize > a.dtype.itemsize and np.any(
            np.isfinite(given) & (np.abs(given) > largest)
        ):
            raise CameraError(
                f"a number of size {np.abs(given[np.isfinite(given)]).max():g} does not fit "
                f"{a.dtype}. Likely cause: uninitialised memory, or a unit of length too small."
            )
    return a


def check_size(what: str, values: Array, largest: float) -> None:
    """Raise `CameraError` if a finite number is larger than can be computed with.

    Args:
        what: What the numbers are, for the message.
        values: Any shape; looked at where they are concrete.
        largest: Largest accepted size. Numbers that are not finite pass: they are visible.
    """
    if not is_concrete(values):
        return
    size = np.abs(np.asarray(values, np.float64))
    if np.any(np.isfinite(size) & (size > largest)):
        raise CameraError(
            f"{what}: expected numbers up to {largest:g}, got {size[np.isfinite(size)].max():g}. "
            "Likely cause: uninitialised memory, or a unit of length too small."
        )


def matmul(a: Array, b: Array) -> Array:
    """Matrix product; never in TF32 or bfloat16, which would bend rays by a pixel."""
    if array_namespace(a, b) is np:
        return np.matmul(a, b)
    return jnp.matmul(a, b, precision=jax.lax.Precision.HIGHEST)


def rigid(rotation: Array, position: Array) -> Array:
    """4x4 transforms from rotations `[..., 3, 3]` and positions `[..., 3]`."""
    xp = array_namespace(rotation, position)
    batch = np.broadcast_shapes(rotation.shape[:-2], position.shape[:-1])
    rotation = xp.broadcast_to(rotation, (*batch, 3, 3))
    position = xp.broadcast_to(position, (*batch, 3))[..., None]
    top = xp.concatenate([rotation, position], axis=-1)
    bottom = xp.broadcast_to(xp.asarray([0, 0, 0, 1], top.dtype), (*batch, 1, 4))
    return xp.concatenate([top, bottom], axis=-2)


def is_concrete(a: Array) -> bool:
    """Whether the values of `a` can be looked at now (false for a tracer inside `jit`)."""
    return not isinstance(a, Tracer)
