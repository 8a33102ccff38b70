"""What MuJoCo can use of this machine, and how Warp is started."""

import functools
import os

import jax

from jaxcam.errors import MachineError


def has_accelerator() -> bool:
    """Whether JAX runs on a GPU or another accelerator; on a CPU Warp has one thread only."""
    return jax.default_backend() != "cpu"


@functools.cache
def start_warp() -> None:
    """Starts Warp without its greeting and, on a machine without CUDA, its complaint.

    Raises:
        MachineError: The folder that its compiled kernels go to cannot be made.
    """
    import warp as wp  # its import takes a second, which who needs no Warp need not wait

    wp.config.log_level = wp.LOG_ERROR
    stderr, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        wp.init()
    except OSError as error:
        raise MachineError(
            f"{error.filename}: {error.strerror}. Warp keeps compiled kernels there: set "
            "WARP_CACHE_PATH to a folder that can be written."
        ) from error
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(nowhere)
