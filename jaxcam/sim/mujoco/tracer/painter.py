"""Pictures of MuJoCo's worlds by the processor's cores."""

import functools
import itertools
import os
import zlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import mujoco
import numba
import numpy as np

from jaxcam.sim.mujoco.render_inputs import Placing, shrunk
from jaxcam.sim.mujoco.scene import Scene
from jaxcam.sim.mujoco.tracer.geometry import Solids, Surfaces, drawable, solids_of, surfaces_of
from jaxcam.sim.mujoco.tracer.kernel import STACK, Hits, Posed
from jaxcam.sim.mujoco.tracer.seeing import see
from jaxcam.sim.mujoco.tracer.shading import Casters, shade
from jaxcam.sim.painter import require_pinholes
from jaxcam.sim.types import View
from jaxcam.sim.world import World

VERSION = 1
"""Of the pictures: to be raised by whoever changes what they look like."""
_FAR = 1e3
"""Depths (m) beyond this count as nothing hit, as in `render_program`."""
_SKY = np.array([191, 204, 216], np.uint8)
"""Colour where no geom is hit, as in `render_program`."""


class CpuRenderer:
    """Draws batches of views of one scene, each core some of them, as MJX's ray tracer would.

    Args:
        scene: Whose visual model is drawn.
        height: Of the pictures (pixels).
        width: Of the pictures (pixels); `height` when None.
        varied: The task's varied geoms of the physics model; `<geom>_vis` is drawn.
        batch: As other painters have it; of no consequence here.
        shadows: Cast shadows by the key light.
        samples: Sub-pixel samples per axis; 2 smooths edges at four times the cost.

    Pictures differ from `render.Renderer`'s where float32 rounds otherwise: by one level of 255 in
    half a percent of the pixels, by more, at edges, in one of a hundred thousand (test).
    """

    def __init__(
        self,
        scene: Scene,
        height: int,
        width: int | None = None,
        *,
        varied: tuple[str, ...] = (),
        batch: int = 32,
        shadows: bool = True,
        samples: int = 1,
    ) -> None:
        self.scene, self.height, self.width = scene, height, width or height
        self.samples, self.batch = samples, batch
        model = scene.visual
        geoms = np.array([model.geom(f"{name}_vis").id for name in varied], int)
        self._size = (self.height * samples, self.width * samples)
        self._placing = Placing(scene, geoms, self._size, samples)
        self._solids, surfaces = _content(model)
        self._surfaces = surfaces._replace(shadowing=surfaces.shadowing & shadows)
        self._reach = np.float32(model.vis.map.zfar * model.stat.extent)

    @staticmethod
    def look(*, shadows: bool = True, samples: int = 1) -> str:
        """The ray tracer's version and settings; see `Painter.look`."""
        kind = "shadows" if shadows else "flat"
        return f"tracer{VERSION}-{mujoco.__version__}-{kind}-{samples}x"

    @staticmethod
    def draws(world: World) -> bool:
        """Whether there is nothing but planes, boxes, cylinders, meshes and distant lights."""
        return isinstance(world, Scene) and drawable(world.visual)

    @staticmethod
    def uses_all_cores() -> bool:
        """Each draws a share of the batch."""
        return True

    def rgb(self, view: View) -> np.ndarray:
        """Pictures, uint8 [B, H, W, 3], top row first."""
        return self.rgb_and_depth(view)[0]

    def rgb_and_depth(self, view: View) -> tuple[np.ndarray, np.ndarray]:
        """Pictures uint8 [B, H, W, 3], and planar depth (m) float32 [B, H, W], inf where empty.

        With several samples per pixel the depth is that of each pixel's upper left one.
        """
        require_pinholes(view)
        count = len(view.qpos)
        rgb = np.empty((count, *self._size, 3), np.uint8)
        depth = np.empty((count, *self._size), np.float32)
        inputs = self._placing.on_host(view)
        posed = Posed(
            inputs.positions, inputs.rotations, inputs.sizes, inputs.eye, inputs.axes,
            inputs.intrinsics, inputs.light_directions, self._reach,
        )  # fmt: skip

        def draw(begin: int, end: int) -> None:
            part = Posed(*(x[begin:end] for x in posed[:-1]), reach=posed.reach)
            room = _room(self._size, self._solids, self._surfaces)
            pictures, depths = rgb[begin:end], depth[begin:end]
            _program()(self._solids, self._surfaces, part, room, _SKY, pictures, depths)

        edges = np.linspace(0, count, min(_cores(), count) + 1).astype(int).tolist()
        shares = list(itertools.pairwise(edges))
        if len(shares) == 1:
            draw(*shares[0])
        else:
            for done in [_pool().submit(draw, *share) for share in shares]:
                done.result()
        depth = depth[:, :: self.samples, :: self.samples]
        return shrunk(rgb, self.samples), np.where(depth > _FAR, np.float32(np.inf), depth)


@functools.cache
def _content(model: Any) -> tuple[Solids, Surfaces]:
    """What is drawn of a model: sorting its triangles takes some tenths of a second."""
    solids, normals = solids_of(model)
    return solids, surfaces_of(model, normals)


def _cores() -> int:
    return os.cpu_count() or 1


@functools.cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(_cores(), "drawing")


def _room(size: tuple[int, int], solids: Solids, surfaces: Surfaces) -> tuple[Hits, Casters]:
    """Room for what is found out about one view."""
    lights, count = len(surfaces.shadowing) - 1, len(solids.kind)
    hits = Hits(
        distance=np.empty(size, np.float32),
        solid=np.empty(size, np.int32),
        geom=np.empty(size, np.int32),
        triangle=np.empty(size, np.int32),
        where=np.empty((*size, 3), np.float32),
        nodes=np.empty(STACK, np.int32),
        entries=np.empty(STACK, np.float32),
        order=np.empty(count, np.int32),
        away=np.empty(count, np.float32),
        light=np.empty((2, 3), np.float32),
    )
    casters = Casters(
        axes=np.empty((lights, 3, 3), np.float32),
        rays=np.empty((lights, count, 3), np.float32),
        ends=np.empty((lights, count, 5), np.float32),
    )
    return hits, casters


@functools.cache
def _program() -> Callable[..., int]:
    """What draws views one after the other: arrays of `posed` have them first."""
    # Numba keeps a function until its own file changes, or what encloses it: so that changes of the
    # other files count too, it is enclosed by what they were.
    sources = [file.read_bytes() for file in sorted(Path(__file__).parent.glob("*.py"))]
    version = zlib.crc32(b"".join(sources))

    @numba.njit(nogil=True, cache=True)
    def draw(
        solids: Solids,
        surfaces: Surfaces,
        posed: Posed,
        room: tuple[Hits, Casters],
        sky: np.ndarray,
        pictures: np.ndarray,
        depths: np.ndarray,
    ) -> int:
        hits, casters = room
        for b in range(len(pictures)):
            one = Posed(
                posed.positions[b], posed.rotations[b], posed.sizes[b], posed.eye[b],
                posed.axes[b], posed.intrinsics[b], posed.lights[b], posed.reach,
            )  # fmt: skip
            see(solids, one, hits)
            shade(solids, surfaces, one, casters, hits, sky, pictures[b])
            for i in range(depths.shape[1]):
                for j in range(depths.shape[2]):
                    empty = hits.solid[i, j] < 0
                    depths[b, i, j] = np.float32(np.inf) if empty else hits.distance[i, j]
        return version

    return draw
