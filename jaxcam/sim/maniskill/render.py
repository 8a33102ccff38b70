"""Batched pictures of ManiSkill's worlds by SAPIEN's rasteriser, in child processes."""

from collections.abc import Sequence
from importlib.metadata import version
from typing import NamedTuple

import numpy as np

from jaxcam.errors import SimError
from jaxcam.sim.maniskill.machine import device, has_accelerator
from jaxcam.sim.maniskill.memory import PIXELS, ROWS
from jaxcam.sim.maniskill.pool import Pool, pool_of
from jaxcam.sim.maniskill.scene import SapienWorld
from jaxcam.sim.maniskill.studio import LIGHT, SHADER
from jaxcam.sim.painter import require_pinholes
from jaxcam.sim.types import View
from jaxcam.sim.world import World

RGB_BYTES, LAYER_BYTES = 3, 11
"""Bytes of a pixel: of its colour alone, and with depth and segment."""


class Layers(NamedTuple):
    """Pictures and what is behind each pixel."""

    rgb: np.ndarray
    """uint8 [B, H, W, 3]."""
    depth: np.ndarray
    """Planar depth (m), to the millimetre; inf where nothing is hit [B, H, W]."""
    segments: np.ndarray
    """Numbers of what is hit [B, H, W]."""
    names: list[str]
    """Names of what is hit, by number: links of the robot and actors."""


class SapienPainter:
    """Draws batches of views of one world.

    Args:
        scene: The world.
        height: Of the pictures (pixels).
        width: Of the pictures (pixels); `height` when None.
        varied: Geoms whose sizes differ between episodes: none do here.
        batch: Views that are drawn at once elsewhere; here as many as there are.
        pool: Processes that draw it; those that the world's other engines and painters use, when
            None.
    """

    def __init__(
        self,
        scene: SapienWorld,
        height: int,
        width: int | None = None,
        *,
        varied: Sequence[str] = (),
        batch: int = 0,
        pool: Pool | None = None,
    ) -> None:
        self.scene, self.height, self.width = scene, height, width or height
        self.pool = pool or pool_of(scene, on_gpu=has_accelerator())

    @staticmethod
    def look() -> str:
        """SAPIEN's version, ManiSkill's shader, what made meshes light; drivers differ a little."""
        light = f"light{LIGHT}-pyfqmr{version('pyfqmr')}"
        return f"sapien{version('sapien')}-{SHADER}-{light}-{device().kind}"

    @staticmethod
    def draws(world: World) -> bool:
        """All there is."""
        return True

    @staticmethod
    def uses_all_cores() -> bool:
        """Each of its child processes draws on a core, or one on the card."""
        return True

    def rgb(self, view: View) -> np.ndarray:
        """Pictures, uint8 [B, H, W, 3], top row first."""
        return self._draw(view, layers=False).rgb

    def layers(self, view: View) -> Layers:
        """Pictures, depths and segments."""
        return self._draw(view, layers=True)

    def _draw(self, view: View, *, layers: bool) -> Layers:
        require_pinholes(view)
        if has_accelerator() and np.ptp(view.K, 0).any():
            raise SimError(
                "On a graphics card SAPIEN's cameras share one K, and these differ: hide the card "
                "(CUDA_VISIBLE_DEVICES=) to draw them on the CPU, or leave fovy, aspect, centre "
                "and lens out."
            )
        count, height, width = len(view.qpos), self.height, self.width
        size, deep = (count, height, width), (count * layers, height, width)
        drawn = Layers(
            np.empty((*size, 3), np.uint8), np.empty(deep, np.float32), np.empty(deep, np.int32), []
        )
        room = PIXELS // ((LAYER_BYTES if layers else RGB_BYTES) * height * width)
        room = max(1, min(ROWS, room))
        children = self.pool.children(count)
        parts = np.array_split(np.arange(count), len(children))
        for first in range(0, max(len(part) for part in parts), room):
            shares = [
                (child, part[first : first + room])
                for child, part in zip(children, parts, strict=True)
                if len(part) > first
            ]
            for child, rows in shares:
                memory, n = child.memory, len(rows)
                memory.qpos[:n], memory.fixtures[:n] = view.qpos[rows], view.fixtures[rows]
                memory.K[:n], memory.camera[:n] = view.K[rows], view.world_from_camera[rows]
            names = self.pool.each(
                [(child, ("draw", len(rows), height, width, layers)) for child, rows in shares]
            )
            for child, rows in shares:
                shared = child.memory.layers(len(rows), height, width)
                for out, part in zip(drawn[:3] if layers else drawn[:1], shared, strict=False):
                    out[rows] = part
            drawn = drawn._replace(names=names[0])
        return drawn
