"""What a painter promises: views of worlds in, pictures out."""

from typing import Any, Protocol

import numpy as np

from jaxcam.errors import SimError
from jaxcam.sim.types import View


class Painter(Protocol):
    """Draws batches of views of one world, all of one size."""

    scene: Any
    """The world (`jaxcam.sim.world.World`) that it draws."""
    height: int
    width: int

    @staticmethod
    def look() -> str:
        """What makes its pictures differ from another painter's: kept with pictures and rows."""
        ...

    @staticmethod
    def draws(world: Any) -> bool:
        """Whether it knows all that is to be seen in a world."""
        ...

    @staticmethod
    def uses_all_cores() -> bool:
        """Whether one draws as fast as several, each in a process of its own."""
        ...

    def rgb(self, view: View) -> np.ndarray:
        """Pictures, uint8 [B, H, W, 3], top row first."""
        ...


def require_pinholes(view: View) -> None:
    """Refuses views with lenses, by a painter that would draw them without.

    Raises:
        SimError: A view has one.
    """
    if view.lens is not None:
        raise SimError("This painter draws no lenses: make it with make_painter(lenses=True).")
