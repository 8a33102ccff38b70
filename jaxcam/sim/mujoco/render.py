"""Batched pictures of a scene by MJX's Warp ray tracer, on CUDA and on the CPU.

It needs the wheel alone: no display, no OpenGL. Scene poses, camera poses and intrinsics are
arrays, one set per world, so a batch of worlds is a batch of cameras. Nothing is simulated here, so
only the render and bounding-volume kernels are ever compiled (once, then cached on disk by Warp).
"""

import copy
import os
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import warp as wp
from mujoco import mjx

from jaxcam.rays import to_mujoco
from jaxcam.rays.rotations import Array, array_namespace
from jaxcam.sim.mujoco.machine import has_accelerator
from jaxcam.sim.mujoco.scene import Scene
from jaxcam.sim.types import View

_FAR = 1e3
"""Depths (m) beyond this count as nothing hit."""
_SKY = (0.75, 0.80, 0.85, 1.0)
"""Colour where no geom is hit."""


def _start_warp() -> None:
    """Starts Warp without its greeting and, on a machine without CUDA, its complaint."""
    wp.config.log_level = wp.LOG_ERROR
    stderr, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        wp.init()
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(nowhere)


_start_warp()


class Renderer:
    """Draws batches of views of one scene.

    Args:
        scene: whose visual model is drawn.
        height: of the pictures (pixels).
        width: of the pictures (pixels); `height` when None.
        varied: the task's varied geoms of the physics model; `<geom>_vis` is drawn.
        batch: worlds per call of the kernel, fixed for good: smaller batches are padded.
        shadows: cast shadows by the key light.
        samples: sub-pixel samples per axis; 2 smooths edges at four times the cost.

    On a CPU Warp draws with one thread, and no two renderers of a process at a time: to use more
    cores, use more processes (`jaxcam.data.pictures`).
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
        self._varied = np.array([model.geom(f"{name}_vis").id for name in varied], int)
        self._kernel = _Kernel(model, batch, self.height * samples, self.width * samples, shadows)
        self._data = mujoco.MjData(model)

    @staticmethod
    def look(*, shadows: bool = True, samples: int = 1) -> str:
        """The ray tracer's version and settings; see `Painter.look`."""
        return f"warp{mujoco.__version__}-{'shadows' if shadows else 'flat'}-{samples}x"

    @staticmethod
    def uses_all_cores() -> bool:
        """On a GPU; on a CPU Warp draws with one thread."""
        return has_accelerator()

    def rgb(self, view: View) -> np.ndarray:
        """Pictures, uint8 [B, H, W, 3], top row first."""
        return self._draw(view)[0]

    def traced(self, view: View) -> jax.Array:
        """`rgb` for use inside a compiled program, poses included: uint8 [B, H, W, 3]."""
        count, full = len(view.qpos), -(-len(view.qpos) // self.batch) * self.batch
        inputs = self._traced_inputs(View(*(jnp.asarray(x, jnp.float32) for x in view)))
        groups = jax.tree.map(
            lambda x: jnp.resize(x, (full, *x.shape[1:])).reshape(-1, self.batch, *x.shape[1:]),
            inputs,
        )
        rgb = jax.lax.map(lambda group: self._shrink(self._kernel.program(group)[0]), groups)
        return rgb.reshape(full, self.height, self.width, 3)[:count]

    def rgb_and_depth(self, view: View) -> tuple[np.ndarray, np.ndarray]:
        """Pictures uint8 [B, H, W, 3], and planar depth (m) float32 [B, H, W], inf where empty.

        With several samples per pixel the depth is that of each pixel's upper left one.
        """
        return self._draw(view)

    def _draw(self, view: View) -> tuple[np.ndarray, np.ndarray]:
        count = len(view.qpos)
        rgb = np.empty((count, self.height, self.width, 3), np.uint8)
        depth = np.empty((count, self.height, self.width), np.float32)
        inputs = self._inputs(view)

        for first in range(0, count, self.batch):
            rows = slice(first, min(first + self.batch, count))
            picture, planar = self._kernel(_Inputs(*(x[rows] for x in inputs)))
            rgb[rows] = self._shrink(picture)
            depth[rows] = planar[:, :: self.samples, :: self.samples]
        return rgb, depth

    def _shrink(self, picture: np.ndarray) -> np.ndarray:
        n = self.samples
        if n == 1:
            return picture
        shape = (len(picture), self.height, n, self.width, n, 3)
        return picture.reshape(shape).mean((2, 4)).round().astype(np.uint8)

    def _cameras(self, view: View) -> tuple[Array, Array, Array]:
        """Positions, axes and intrinsics of the cameras, in the kernel's terms."""
        xp = array_namespace(view.K)
        eye, axes = to_mujoco(view.world_from_camera)
        K = view.K * self.samples
        middle = np.array([self.width, self.height]) * self.samples / 2
        intrinsics = xp.stack([K[:, 0, 0], K[:, 1, 1], *(middle - K[:, :2, 2]).T], -1)
        return eye, axes.reshape(-1, 3, 3), intrinsics

    def _traced_inputs(self, view: View) -> "_Inputs":
        """As `_inputs`, with MuJoCo Warp's kinematics."""
        model, base = self._kernel.model, self._kernel.data
        eye, axes, intrinsics = self._cameras(view)
        sizes = jnp.broadcast_to(model.geom_size, (len(view.qpos), *model.geom_size.shape))

        def poses(qpos: jax.Array, fixtures: jax.Array) -> tuple[jax.Array, ...]:
            data = base.replace(
                qpos=qpos,
                mocap_pos=base.mocap_pos.at[self.scene.fixtures].set(fixtures[:, :3]),
                mocap_quat=base.mocap_quat.at[self.scene.fixtures].set(fixtures[:, 3:]),
            )
            data = mjx.kinematics(model, data)
            body = self.scene.visual.light_bodyid  # lights are fixed to their bodies
            axes = data.xmat[body]
            at = data.xpos[body] + (axes @ model.light_pos[..., None])[..., 0]
            return data.geom_xpos, data.geom_xmat, at, (axes @ model.light_dir[..., None])[..., 0]

        with jax.default_matmul_precision("highest"):
            positions, rotations, lights, directions = jax.vmap(poses)(view.qpos, view.fixtures)
        return _Inputs(
            positions=positions,
            rotations=rotations,
            sizes=sizes.at[:, self._varied].set(view.geom_size),
            eye=eye,
            axes=axes,
            intrinsics=intrinsics,
            light_positions=lights,
            light_directions=directions,
        )

    def _inputs(self, view: View) -> "_Inputs":
        """Poses by MuJoCo's kinematics, cameras in MuJoCo's axes, intrinsics in its terms."""
        model, data, count = self.scene.visual, self._data, len(view.qpos)
        sizes = np.repeat(model.geom_size[None], count, 0)
        sizes[:, self._varied] = view.geom_size
        eye, axes, intrinsics = self._cameras(
            view._replace(
                K=np.asarray(view.K, float),
                world_from_camera=np.asarray(view.world_from_camera, float),
            )
        )
        inputs = _Inputs(
            positions=np.empty((count, model.ngeom, 3), np.float32),
            rotations=np.empty((count, model.ngeom, 3, 3), np.float32),
            sizes=sizes.astype(np.float32),
            eye=np.asarray(eye, np.float32),
            axes=np.asarray(axes, np.float32),
            intrinsics=np.asarray(intrinsics, np.float32),
            light_positions=np.empty((count, model.nlight, 3), np.float32),
            light_directions=np.empty((count, model.nlight, 3), np.float32),
        )
        for i in range(count):
            data.qpos[:] = view.qpos[i]
            data.mocap_pos[self.scene.fixtures] = view.fixtures[i, :, :3]
            data.mocap_quat[self.scene.fixtures] = view.fixtures[i, :, 3:]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_camlight(model, data)
            inputs.positions[i] = data.geom_xpos
            inputs.rotations[i] = data.geom_xmat.reshape(-1, 3, 3)
            inputs.light_positions[i], inputs.light_directions[i] = data.light_xpos, data.light_xdir
        return inputs


class _Inputs(NamedTuple):
    """What the kernel reads of each world, float32, batch first."""

    positions: Any
    rotations: Any
    sizes: Any
    eye: Any
    axes: Any
    intrinsics: Any
    light_positions: Any
    light_directions: Any


class _Kernel:
    """One Warp render context of fixed width, and the compiled program that fills it."""

    def __init__(
        self, model: mujoco.MjModel, batch: int, height: int, width: int, shadows: bool
    ) -> None:
        model = _in_pixels(model, height, width)
        self._batch = batch
        self._context = mjx.create_render_context(
            mjm=model,
            nworld=batch,
            cam_res=(width, height),
            render_rgb=True,
            render_depth=True,
            use_shadows=shadows,
            use_precomputed_rays=False,  # precomputed rays silently ignore per-world intrinsics
            enabled_geom_groups=[1],
            background_color=_SKY,
        )
        here = jax.local_devices()[0]  # of several processes' devices MJX takes the first of all
        mx = mjx.put_model(model, here, impl="warp")
        dx = mjx.make_data(model, here, impl="warp")
        handle = self._context.pytree()

        def draw(inputs: "_Inputs") -> tuple[jax.Array, jax.Array]:
            m = mx.tree_replace(
                {"cam_intrinsic": inputs.intrinsics[None], "geom_size": inputs.sizes}
            )
            d = dx.tree_replace(
                {
                    "geom_xpos": inputs.positions,
                    "geom_xmat": inputs.rotations,
                    "cam_xpos": inputs.eye[None],
                    "cam_xmat": inputs.axes[None],
                    "_impl.light_xpos": inputs.light_positions,
                    "_impl.light_xdir": inputs.light_directions,
                }
            )
            packed, depth, _ = mjx.render(m, mjx.refit_bvh(m, d, handle), handle)
            return packed, depth

        @jax.jit
        def program(inputs: "_Inputs") -> tuple[jax.Array, jax.Array]:
            packed, depth = jax.vmap(draw)(inputs)
            bytes_ = jax.lax.bitcast_convert_type(packed, jnp.uint8)  # B, G, R, A
            rgb = bytes_[..., 2::-1].reshape(batch, height, width, 3)
            depth = depth.reshape(batch, height, width)
            return rgb, jnp.where((depth <= 0) | (depth > _FAR), jnp.inf, depth)

        self.model, self.data, self.program = mx, dx, program

    def __call__(self, inputs: "_Inputs") -> tuple[np.ndarray, np.ndarray]:
        count = len(inputs.eye)
        if count < self._batch:
            short = self._batch - count
            inputs = _Inputs(*(np.concatenate([x, np.repeat(x[-1:], short, 0)]) for x in inputs))
        rgb, depth = self.program(inputs)
        return np.asarray(rgb)[:count], np.asarray(depth)[:count]


def _in_pixels(model: mujoco.MjModel, height: int, width: int) -> mujoco.MjModel:
    """A copy of the model whose camera sensor is measured in pixels, so that K goes in as it is."""
    model = copy.copy(model)
    model.cam_sensorsize[:] = width, height
    model.cam_resolution[:] = width, height
    return model
