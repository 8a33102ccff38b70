"""What tasks on robosuite's table are made of, in words; `jaxcam.sim.mujoco.mjcf` builds it."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

Colour = tuple[float, float, float, float]
"""Red, green, blue and opacity, in [0, 1]."""
Size = tuple[float, float, float]


@dataclass(frozen=True)
class Box:
    """A box of uniform density."""

    name: str
    half_size: Size
    """(m)."""
    rgba: Colour


@dataclass(frozen=True)
class Can:
    """robosuite's can."""

    name: str


@dataclass(frozen=True)
class CanGhost:
    """robosuite's can to look at, without a joint: for markers."""

    name: str
    scale: float
    """Its size, as a multiple of the can's."""
    rgba: Colour


@dataclass(frozen=True)
class SquareNut:
    """robosuite's square nut with its handle."""

    name: str


@dataclass(frozen=True)
class Piece:
    """A part of a `Compound`."""

    name: str
    shape: Literal["box", "capsule", "cylinder"]
    size: tuple[float, ...]
    """Half-sizes (m) [3] of a box; radius and half-length (m) of the others."""
    place: Size
    """Its middle (m) [3], seen from the compound's."""
    density: float | None
    """(kg/m³); None for what is only seen."""
    role: Literal["all", "collision", "visual"] = "all"
    """What it is for: to touch, to see, or both."""


@dataclass(frozen=True)
class Compound:
    """Pieces that move together."""

    name: str
    half_size: Size
    """Half-size (m) [3] of a box around all of them."""
    pieces: tuple[Piece, ...]
    rgba: Colour


Object = Box | Can | CanGhost | SquareNut | Compound


def prism(radius: float, half_height: float, sides: int) -> np.ndarray:
    """Corners [2 * sides, 3] of an upright prism; `radius` (m) is the mean of its in- and outer.

    It stands in for a cylinder, which MJX-JAX cannot collide with boxes and meshes.
    """
    turn = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    outer = 2 * radius / (1 + np.cos(np.pi / sides))
    ring = outer * np.stack([np.cos(turn), np.sin(turn)], -1)
    ends = np.repeat([-half_height, half_height], sides)
    return np.column_stack([np.tile(ring, (2, 1)), ends])
