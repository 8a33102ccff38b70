"""MJX's Warp ray tracer as one compiled program: poses and cameras in, pictures out."""

import copy

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from jaxcam.sim.mujoco.machine import start_warp
from jaxcam.sim.mujoco.render_inputs import Inputs, Placing
from jaxcam.sim.types import View

_FAR = 1e3
"""Depths (m) beyond this count as nothing hit."""
_SKY = (0.75, 0.80, 0.85, 1.0)
"""Colour where no geom is hit."""


class Kernel:
    """One Warp render context of fixed width, and the compiled program that fills it.

    Args:
        model: What is drawn.
        batch: Worlds per call: smaller batches are padded.
        height: Of the pictures (pixels).
        width: Of the pictures (pixels).
        shadows: Whether the key light casts shadows.
    """

    def __init__(
        self, model: mujoco.MjModel, batch: int, height: int, width: int, shadows: bool
    ) -> None:
        start_warp()
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

        def draw(inputs: Inputs) -> tuple[jax.Array, jax.Array]:
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
        def program(inputs: Inputs) -> tuple[jax.Array, jax.Array]:
            packed, depth = jax.vmap(draw)(inputs)
            bytes_ = jax.lax.bitcast_convert_type(packed, jnp.uint8)  # B, G, R, A
            rgb = bytes_[..., 2::-1].reshape(batch, height, width, 3)
            depth = depth.reshape(batch, height, width)
            return rgb, jnp.where((depth <= 0) | (depth > _FAR), jnp.inf, depth)

        self.model, self.data, self.program = mx, dx, program

    def __call__(self, inputs: Inputs) -> tuple[np.ndarray, np.ndarray]:
        """Pictures uint8 [B, H, W, 3] and planar depths (m) [B, H, W] of at most `batch` worlds."""
        count = len(inputs.eye)
        if count < self._batch:
            short = self._batch - count
            inputs = Inputs(*(np.concatenate([x, np.repeat(x[-1:], short, 0)]) for x in inputs))
        rgb, depth = self.program(inputs)
        return np.asarray(rgb)[:count], np.asarray(depth)[:count]


def traced_inputs(placing: Placing, kernel: Kernel, view: View) -> Inputs:
    """As `Placing.on_host`, inside a compiled program, by MuJoCo Warp's kinematics.

    Args:
        placing: Of the scene.
        kernel: That draws it; its model and data are used.
        view: What is drawn.
    """
    scene, model, base = placing.scene, kernel.model, kernel.data
    eye, axes, intrinsics = placing.cameras(view)
    sizes = jnp.broadcast_to(model.geom_size, (len(view.qpos), *model.geom_size.shape))

    def poses(qpos: jax.Array, fixtures: jax.Array) -> tuple[jax.Array, ...]:
        data = base.replace(
            qpos=qpos,
            mocap_pos=base.mocap_pos.at[scene.fixtures].set(fixtures[:, :3]),
            mocap_quat=base.mocap_quat.at[scene.fixtures].set(fixtures[:, 3:]),
        )
        data = mjx.kinematics(model, data)
        body = scene.visual.light_bodyid  # lights are fixed to their bodies
        axes = data.xmat[body]
        at = data.xpos[body] + (axes @ model.light_pos[..., None])[..., 0]
        return data.geom_xpos, data.geom_xmat, at, (axes @ model.light_dir[..., None])[..., 0]

    with jax.default_matmul_precision("highest"):
        positions, rotations, lights, directions = jax.vmap(poses)(view.qpos, view.fixtures)
    return Inputs(
        positions=positions,
        rotations=rotations,
        sizes=sizes.at[:, placing.varied].set(view.geom_size),
        eye=eye,
        axes=axes,
        intrinsics=intrinsics,
        light_positions=lights,
        light_directions=directions,
    )


def _in_pixels(model: mujoco.MjModel, height: int, width: int) -> mujoco.MjModel:
    """A copy of the model whose camera sensor is measured in pixels, so that K goes in as it is."""
    model = copy.copy(model)
    model.cam_sensorsize[:] = width, height
    model.cam_resolution[:] = width, height
    return model
