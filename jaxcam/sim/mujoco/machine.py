"""What MuJoCo can use of this machine."""

import jax


def has_accelerator() -> bool:
    """Whether JAX runs on a GPU or another accelerator; on a CPU Warp has one thread only."""
    return jax.default_backend() != "cpu"
