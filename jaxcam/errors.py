"""Errors a user can act on, and how a command line shows them.

A message says what is wrong, where, what was expected and what was got, the likely cause, and the
fix. Each kind of error has its own exit code, so that scripts can tell them apart.
"""

import difflib
from collections.abc import Iterable
from typing import ClassVar


class JaxcamError(Exception):
    """Base of every error raised on purpose."""

    exit_code: ClassVar[int] = 1


class ConfigError(JaxcamError, ValueError):
    """A setting is unknown, out of range, or at odds with another one."""

    exit_code = 2


class CameraError(JaxcamError, ValueError):
    """A camera is impossible: its intrinsics, pose or image size."""

    exit_code = 3


class DatasetError(JaxcamError, ValueError):
    """A dataset is missing, damaged, or not the one that was asked for."""

    exit_code = 3


class CheckpointError(JaxcamError):
    """A checkpoint cannot be written, read, or trusted."""

    exit_code = 4


class SimError(JaxcamError):
    """A simulator or renderer failed."""

    exit_code = 5


class MachineError(JaxcamError):
    """The machine refused something: a file, room, rights, memory or a device."""

    exit_code = 7


class PortError(JaxcamError, RuntimeError):
    """A policy server, or one who asks it, is gone, or says what the other cannot use."""

    exit_code = 8


class NoServerError(PortError):
    """There is no policy server at an address, or not any more."""


class RefusedError(PortError):
    """A policy server says that it cannot use what it was sent."""


class DivergedError(JaxcamError):
    """Training produced non-finite numbers for too long."""

    exit_code = 6


def closest(name: str, known: Iterable[str], alike: float = 0.5) -> str:
    """End of an "unknown name" message: the nearest known name, then all of them.

    Args:
        name: The name that was not found.
        known: The names that exist.
        alike: Likeness from 0 to 1 from which a name may have been meant.

    Returns:
        For example ", did you mean 'lift'? Known: lift, square".
    """
    names = list(known)
    lower = {n.lower(): n for n in names}
    near = difflib.get_close_matches(name.lower(), lower, n=1, cutoff=alike)
    hint = f", did you mean '{lower[near[0]]}'?" if near else "."
    return f"{hint} Known: {', '.join(names)}"
