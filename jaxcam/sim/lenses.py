"""Pictures through a lens: sampled from a wider picture without one, which painters draw.

The tracers here take pinholes. A pixel of a lens looks along some ray, and a pinhole's picture of
twice the size that just covers all rays of a picture has that ray's colour between four pixels.
"""

from types import ModuleType
from typing import Any

import numpy as np

from jaxcam.rays.lens import normalised, sight_lines
from jaxcam.rays.rotations import Array, array_namespace
from jaxcam.sim.painter import Painter
from jaxcam.sim.types import View

SCALE = 2
"""Sides of the wider picture by those of the picture."""
WIDEST = np.tan(np.deg2rad(80))
"""Rays further from the axis than this (X/Z, Y/Z) are not drawn: a pinhole's picture of them would
be nothing but its edge."""


class LensPainter:
    """Draws views through their lenses.

    Args:
        painter: Draws those that have none.
        wide: Draws the same world, `SCALE` times as high and wide.
    """

    def __init__(self, painter: Painter, wide: Painter) -> None:
        self._painter, self._wide = painter, wide
        self.scene, self.height, self.width = painter.scene, painter.height, painter.width

    def look(self) -> str:
        """What makes its pictures differ from another painter's."""
        return f"{self._painter.look()}-lens{SCALE}x"

    def draws(self, world: Any) -> bool:
        """As the painter whose pictures it samples."""
        return self._painter.draws(world)

    def uses_all_cores(self) -> bool:
        """As the painter whose pictures it samples."""
        return self._painter.uses_all_cores()

    def rgb(self, view: View) -> np.ndarray:
        """Pictures, uint8 [B, H, W, 3], top row first; black where a pixel has no ray."""
        if view.lens is None:
            return self._painter.rgb(view)
        K, at, drawn = self._covering(view)
        wide = self._wide.rgb(view._replace(K=K, lens=None))
        return sampled(wide, *at, drawn)

    def traced(self, view: View) -> Array:
        """`rgb` for use inside a compiled program, of painters that have one."""
        plain: Any = self._painter
        compiled: Any = self._wide
        if view.lens is None:
            return plain.traced(view)
        K, at, drawn = self._covering(view)
        return sampled(compiled.traced(view._replace(K=K, lens=None)), *at, drawn)

    def _covering(self, view: View) -> tuple[Array, tuple[Array, Array], Array]:
        """K of the wider pictures, where in them pixels look (u, v), and which pixels do."""
        xp = array_namespace(view.K)
        K = view.K[:, None, None]
        u = xp.arange(self.width) + 0.5
        v = xp.arange(self.height)[:, None] + 0.5
        assert view.lens is not None
        lens = view.lens[:, None, None]
        x, y, z = sight_lines(*normalised(K, u, v), lens, "opencv")
        ahead = z > 0
        x, y = (xp.where(ahead, a / xp.where(ahead, z, 1), 0) for a in (x, y))
        drawn = ahead & (abs(x) <= WIDEST) & (abs(y) <= WIDEST)
        fx, cx = _covered(xp, x, drawn, self._wide.width)
        fy, cy = _covered(xp, y, drawn, self._wide.height)
        zero, one = xp.zeros_like(fx), xp.ones_like(fx)
        wide = xp.stack([fx, zero, cx, zero, fy, cy, zero, zero, one], -1).reshape(-1, 3, 3)
        f, c = xp.stack([fx, fy]), xp.stack([cx, cy])
        at = f[..., None, None] * xp.stack([x, y]) + c[..., None, None]
        return wide, (at[0], at[1]), drawn


def _covered(xp: ModuleType, a: Array, drawn: Array, size: int) -> tuple[Array, Array]:
    """Focal length and principal point by which a picture's side just covers coordinates [B, …]."""
    low = xp.where(drawn, a, WIDEST).min((1, 2))
    high = xp.where(drawn, a, -WIDEST).max((1, 2))
    f = (size - 1) / xp.maximum(high - low, 1e-3)  # from the middle of the first pixel to the last
    return f, 0.5 - f * low


def sampled(pictures: Array, u: Array, v: Array, drawn: Array) -> Array:
    """Pictures sampled between their pixels.

    Args:
        pictures: What is sampled, uint8 [B, H, W, 3].
        u: Columns [B, h, w], the middle of the first pixel at 0.5.
        v: Rows, likewise.
        drawn: Which samples are wanted [B, h, w]; the others are black.

    Returns:
        uint8 [B, h, w, 3].
    """
    xp = array_namespace(pictures, u)
    height, width = pictures.shape[1:3]
    u, v = xp.clip(u - 0.5, 0, width - 1), xp.clip(v - 0.5, 0, height - 1)
    left = xp.clip(xp.floor(u).astype(int), 0, width - 2)
    top = xp.clip(xp.floor(v).astype(int), 0, height - 2)
    across, down = (u - left)[..., None], (v - top)[..., None]
    of = np.arange(len(pictures))[:, None, None]

    def at(row: int, column: int) -> Array:
        return pictures[of, top + row, left + column].astype(np.float32)

    upper = at(0, 0) * (1 - across) + at(0, 1) * across
    lower = at(1, 0) * (1 - across) + at(1, 1) * across
    values = upper * (1 - down) + lower * down
    return xp.where(drawn[..., None], xp.round(values), 0).astype(np.uint8)
