"""How a command's process keeps memory: what it was given once, it keeps for its next arrays."""

import ctypes
import gc
import os

_RARELY = (100_000, 20, 20)
"""When the garbage collector looks through young and older objects. What is imported and traced is
hundreds of thousands of objects that stay; by its own thresholds it takes a fifth of the start."""
_TRIM_THRESHOLD, _TOP_PAD, _MMAP_MAX = -1, -2, -4
"""Names of glibc's settings, see mallopt(3)."""
_AT_ONCE = 2**28
"""Bytes that are asked of the system at least."""


def keep_memory() -> None:
    """Ask for memory seldom, and look through it seldom.

    An update on a CPU takes and frees gigabytes. glibc gives large pieces back to the system each
    time, which clears them again page by page: a sixth of an update of the laptop preset. Settings
    of the user's (`MALLOC_…`, `GLIBC_TUNABLES`) and other C libraries are left as they are.
    """
    gc.set_threshold(*_RARELY)
    if any(name.startswith(("MALLOC_", "GLIBC_TUNABLES")) for name in os.environ):
        return
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # no glibc
        return
    for setting, value in ((_TRIM_THRESHOLD, -1), (_TOP_PAD, _AT_ONCE), (_MMAP_MAX, 0)):
        mallopt(setting, value)
