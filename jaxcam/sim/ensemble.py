"""Temporal ensembling: every step executes a mean of all that was ever predicted for it.

The policy is asked at every step; predictions of a step are weighed by exp(-rate * i), where i = 0
is the oldest (Zhao et al., "Learning Fine-Grained Bimanual Manipulation with Low-Cost Hardware").
"""

import numpy as np

from jaxcam.rays.rotations import Array, array_namespace


def ensemble(mean: Array, chunk: Array, call: Array, rate: float = 0.01) -> tuple[Array, Array]:
    """Takes in the chunk predicted now; under NumPy and under `jax.jit`.

    Args:
        mean: Of what the calls before predicted for the chunk's steps [B, T, N]; at call 0, and
            wherever nothing was predicted, any finite numbers.
        chunk: Targets from now on [B, T, N]. They must mean the same whenever they are predicted,
            and a mean of them must have a meaning: no differences, no angles.
        call: Number of this call, from 0; there is one every step.
        rate: How much less each newer prediction weighs; below 0, how much more.

    Returns:
        What to execute now [B, N], and `mean` for the next call.
    """
    xp, length = array_namespace(mean), chunk.shape[1]
    # Of a step's predictions, the last of n + 1 has this share of all their weight.
    shares = 1 / np.cumsum(np.exp(rate * np.arange(length)))
    before = xp.minimum(call, np.arange(length)[::-1])
    share = xp.asarray(shares, mean.dtype)[before][:, None]
    mean = (1 - share) * mean + share * chunk
    return mean[:, 0], xp.concatenate([mean[:, 1:], mean[:, -1:]], 1)
