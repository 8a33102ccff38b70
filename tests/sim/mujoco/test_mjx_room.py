"""Room for contacts is doubled until none is lost, or said to be too little."""

import jax
import jax.numpy as jnp
import pytest

from jaxcam.errors import SimError
from jaxcam.sim.mujoco.mjx_room import LOST_FOR_GOOD, Room

ROWS, CONTACTS = 1 << 0, 1 << 3


def run(room, needed, bits):
    """Computes as an engine does that needs so much room; how often it did, and renewed."""
    computed, renewed = [], []

    def compute():
        computed.append(room.contacts)
        short = room.contacts < needed
        jax.jit(room.report)(jnp.array([0, bits if short else 0, LOST_FOR_GOOD]))
        return room.contacts

    assert room.make_sure("fixed", compute, lambda: renewed.append(room.contacts)) >= needed
    return computed, renewed


def test_room_is_doubled_until_it_suffices():
    room = Room(contacts=4)
    assert room.rows == 16
    assert run(room, 13, CONTACTS) == ([4, 8, 16], [8, 16])
    assert room.rows == 16
    assert run(room, 13, CONTACTS) == ([16], [])  # and is kept


def test_what_is_short_is_what_grows():
    room = Room(contacts=4, rows=8, most_rows=16)
    with pytest.raises(SimError, match=r"room for 16 rows .*'fixed' needs more than 16"):
        run(room, 5, ROWS)
    assert room.contacts == 4
