"""A process that may not write where it may usually."""

import contextlib
import os

NOBODY = 65534


@contextlib.contextmanager
def no_rights():
    """Root gives its rights up; anybody else has none to give.

    Where only root may read the place that jaxcam is installed in, what runs within cannot import
    it either: import before, and make the arguments before.
    """
    was_root = os.geteuid() == 0
    if was_root:
        os.seteuid(NOBODY)
    try:
        yield
    finally:
        if was_root:
            os.seteuid(0)
