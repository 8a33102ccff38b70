"""Room for contacts, which MuJoCo Warp wants to know beforehand: doubled where it is short."""

import functools
import logging
from collections.abc import Callable
from typing import TypeVar

import jax
import numpy as np

from jaxcam.errors import SimError

T = TypeVar("T")

MOST_CONTACTS, MOST_ROWS = 512, 2048
"""Room a world that no sound scene needs."""
_LOG = logging.getLogger(__name__)
_OVERFLOWS = {
    1 << 0: "rows",  # more constraint rows in a world than njmax
    1 << 1: "rows",  # njmax_nnz, which follows from njmax
    1 << 2: "contacts",  # more pairs near each other than naconmax
    1 << 3: "contacts",  # more contacts than naconmax
    1 << 4: "contacts",  # naccdmax, which follows from naconmax
}
"""Bits of MuJoCo Warp's `overflow` that mean lost contacts, and the argument to raise. The others
tell of what this project does not use, or of a solver that stopped at its limit of iterations,
which MuJoCo's C library does in silence too; but for the one below."""
LOST_FOR_GOOD = 1 << 8
"""The bit that a world lost a contact for which no argument makes room: while Warp looked for the
depth of two convex shapes in each other (EPA), more edges were in sight than its 24."""


class Room:
    """How much room there is in each world, and whether it was enough so far.

    Args:
        contacts: Room for contacts, per world on average over the batch.
        rows: Room for constraint rows; four for each contact when None.
        most_contacts: More than this is an error.
        most_rows: More than this is an error.
    """

    def __init__(
        self,
        contacts: int,
        rows: int | None = None,
        most_contacts: int = MOST_CONTACTS,
        most_rows: int = MOST_ROWS,
    ) -> None:
        self._size = {"contacts": contacts, "rows": rows or 4 * contacts}
        self._most = {"contacts": most_contacts, "rows": most_rows}
        self._overflow = 0

    @property
    def contacts(self) -> int:
        """Room for contacts, per world on average over the batch."""
        return self._size["contacts"]

    @property
    def rows(self) -> int:
        """Room for constraint rows in each world."""
        return self._size["rows"]

    def report(self, overflow: jax.Array) -> None:
        """Tells of lost contacts from inside a compiled program.

        Args:
            overflow: MuJoCo Warp's bits of each world [B].
        """
        bits = jax.lax.reduce(overflow & sum(_OVERFLOWS), 0, jax.lax.bitwise_or, (0,))
        remember = functools.partial(jax.debug.callback, self._remember)
        jax.lax.cond(bits != 0, remember, lambda _: None, bits)

    def make_sure(self, scene: str, compute: Callable[[], T], renew: Callable[[], None]) -> T:
        """What `compute` gives, once no contacts are lost for want of room.

        Args:
            scene: The scene's name, for the error.
            compute: Runs programs that `report`.
            renew: Makes the programs anew, after the room was doubled.

        Raises:
            SimError: If contacts were lost for want of room, however much there was.
        """
        while True:
            result = jax.block_until_ready(compute())
            jax.effects_barrier()
            bits, self._overflow = self._overflow, 0
            short = {name for bit, name in _OVERFLOWS.items() if bits & bit}
            if not short:
                return result
            for name in sorted(short):
                self._double(name, scene)
            renew()

    def _remember(self, bits: np.ndarray) -> None:
        self._overflow |= int(bits)

    def _double(self, name: str, scene: str) -> None:
        lost = f"MJX-Warp had room for {self._size[name]} {name} a world, and lost contacts."
        self._size[name] *= 2
        if self._size[name] > self._most[name]:
            raise SimError(
                f"{lost} The scene {scene!r} needs more than {self._most[name]}: look at the "
                "physics, or choose --engine native."
            )
        _LOG.warning("%s It goes on with %d, from where that was.", lost, self._size[name])
