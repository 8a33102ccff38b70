"""Batched pictures of a scene by MJX's Warp ray tracer, on CUDA and on the CPU.

It needs the wheel alone: no display, no OpenGL. Scene poses, camera poses and intrinsics are
arrays, one set per world, so a batch of worlds is a batch of cameras. Nothing is simulated here, so
only the render and bounding-volume kernels are ever compiled (once, then cached on disk by Warp).
"""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from jaxcam.sim.mujoco.machine import has_accelerator
from jaxcam.sim.mujoco.render_inputs import Inputs, Placing, shrunk
from jaxcam.sim.mujoco.render_program import Kernel, traced_inputs
from jaxcam.sim.mujoco.scene import Scene
from jaxcam.sim.painter import require_pinholes
from jaxcam.sim.types import View
from jaxcam.sim.world import World


class Renderer:
    """Draws batches of views of one scene.

    Args:
        scene: Whose visual model is drawn.
        height: Of the pictures (pixels).
        width: Of the pictures (pixels); `height` when None.
        varied: The task's varied geoms of the physics model; `<geom>_vis` is drawn.
        batch: Worlds per call of the kernel, fixed for good: smaller batches are padded.
        shadows: Cast shadows by the key light.
        samples: Sub-pixel samples per axis; 2 smooths edges at four times the cost.

    It draws on CUDA, and on any machine inside the programs of the MJX engines. On a CPU Warp draws
    with one thread, and no two renderers of a process at a time; `tracer.CpuRenderer` is faster.
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
        size = (self.height * samples, self.width * samples)
        self._placing = Placing(scene, geoms, size, samples)
        self._kernel = Kernel(model, batch, *size, shadows)

    @staticmethod
    def look(*, shadows: bool = True, samples: int = 1) -> str:
        """The ray tracer's version and settings; see `Painter.look`."""
        return f"warp{mujoco.__version__}-{'shadows' if shadows else 'flat'}-{samples}x"

    @staticmethod
    def draws(world: World) -> bool:
        """All there is."""
        return True

    @staticmethod
    def uses_all_cores() -> bool:
        """On a GPU; on a CPU Warp draws with one thread."""
        return has_accelerator()

    def rgb(self, view: View) -> np.ndarray:
        """Pictures, uint8 [B, H, W, 3], top row first."""
        return self.rgb_and_depth(view)[0]

    def traced(self, view: View) -> jax.Array:
        """`rgb` for use inside a compiled program, poses included: uint8 [B, H, W, 3]."""
        count, full = len(view.qpos), -(-len(view.qpos) // self.batch) * self.batch
        require_pinholes(view)
        view = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), view)
        inputs = traced_inputs(self._placing, self._kernel, view)
        groups = jax.tree.map(
            lambda x: jnp.resize(x, (full, *x.shape[1:])).reshape(-1, self.batch, *x.shape[1:]),
            inputs,
        )
        rgb = jax.lax.map(
            lambda group: shrunk(self._kernel.program(group)[0], self.samples), groups
        )
        return rgb.reshape(full, self.height, self.width, 3)[:count]

    def rgb_and_depth(self, view: View) -> tuple[np.ndarray, np.ndarray]:
        """Pictures uint8 [B, H, W, 3], and planar depth (m) float32 [B, H, W], inf where empty.

        With several samples per pixel the depth is that of each pixel's upper left one.
        """
        require_pinholes(view)
        count = len(view.qpos)
        rgb = np.empty((count, self.height, self.width, 3), np.uint8)
        depth = np.empty((count, self.height, self.width), np.float32)
        inputs = self._placing.on_host(view)
        for first in range(0, count, self.batch):
            rows = slice(first, min(first + self.batch, count))
            picture, planar = self._kernel(Inputs(*(x[rows] for x in inputs)))
            rgb[rows] = shrunk(picture, self.samples)
            depth[rows] = planar[:, :: self.samples, :: self.samples]
        return rgb, depth
