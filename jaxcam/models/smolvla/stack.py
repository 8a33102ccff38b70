"""Many layers of one shape as one loop."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from flax import nnx

X = TypeVar("X")


def through(
    blocks: Sequence[Any],
    step: Callable[[Any, X, Any], tuple[X, Any]],
    x: X,
    beside: Any = None,
    *,
    remat: bool,
) -> tuple[X, Any]:
    """Carry a value through blocks of layers that have the same shapes.

    The loop is compiled once for all blocks, which takes minutes off SmolVLA's 44 layers.

    Args:
        blocks: Modules, or tuples of modules.
        step: ``step(block, x, item)`` gives the next x and a block's output.
        x: The first value.
        beside: A tree of arrays with an item for every block along the first axis.
        remat: Whether the backward pass computes a block again instead of keeping what happened in
            it. As a loop, that also holds where XLA would share the two computations again.

    Returns:
        The last value, and the outputs stacked along a new first axis.
    """
    graphdef, _ = nnx.split(blocks[0])
    states = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(nnx.split(b)[1] for b in blocks))

    def body(x: X, each: tuple[Any, Any]) -> tuple[X, Any]:
        state, item = each
        return step(nnx.merge(graphdef, state), x, item)

    body = jax.checkpoint(body, prevent_cse=False) if remat else body
    # Without it the loop is written out: small networks run faster so.
    return jax.lax.scan(body, x, (states, beside), unroll=1 if remat else len(blocks))
