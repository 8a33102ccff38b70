"""Views in the ray tracer's terms: where every geom, light and camera is."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from jaxcam.rays import to_mujoco
from jaxcam.rays.rotations import Array, array_namespace
from jaxcam.sim.mujoco.render_program import Inputs
from jaxcam.sim.mujoco.scene import Scene
from jaxcam.sim.types import View


class Placing:
    """Places a scene's geoms, lights and cameras.

    Args:
        scene: Whose visual model is drawn.
        varied: The varied geoms' numbers in that model.
        size: Height and width of the traced pictures (pixels).
        samples: Of a picture's pixel along each axis.
    """

    def __init__(
        self, scene: Scene, varied: np.ndarray, size: tuple[int, int], samples: int
    ) -> None:
        self._scene, self._varied = scene, varied
        self._size, self._samples = size, samples
        self._data = mujoco.MjData(scene.visual)

    def on_host(self, view: View) -> Inputs:
        """Poses by MuJoCo's kinematics, cameras in MuJoCo's axes, intrinsics in its terms."""
        model, data, count = self._scene.visual, self._data, len(view.qpos)
        sizes = np.repeat(model.geom_size[None], count, 0)
        sizes[:, self._varied] = view.geom_size
        eye, axes, intrinsics = self._cameras(
            view._replace(
                K=np.asarray(view.K, float),
                world_from_camera=np.asarray(view.world_from_camera, float),
            )
        )
        inputs = Inputs(
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
            data.mocap_pos[self._scene.fixtures] = view.fixtures[i, :, :3]
            data.mocap_quat[self._scene.fixtures] = view.fixtures[i, :, 3:]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_camlight(model, data)
            inputs.positions[i] = data.geom_xpos
            inputs.rotations[i] = data.geom_xmat.reshape(-1, 3, 3)
            inputs.light_positions[i], inputs.light_directions[i] = data.light_xpos, data.light_xdir
        return inputs

    def traced(self, model: mjx.Model, base: mjx.Data, view: View) -> Inputs:
        """As `on_host`, inside a compiled program, by MuJoCo Warp's kinematics.

        Args:
            model: MJX's of the scene's visual model.
            base: Data that poses are put into.
            view: What is drawn.
        """
        eye, axes, intrinsics = self._cameras(view)
        sizes = jnp.broadcast_to(model.geom_size, (len(view.qpos), *model.geom_size.shape))

        def poses(qpos: jax.Array, fixtures: jax.Array) -> tuple[jax.Array, ...]:
            data = base.replace(
                qpos=qpos,
                mocap_pos=base.mocap_pos.at[self._scene.fixtures].set(fixtures[:, :3]),
                mocap_quat=base.mocap_quat.at[self._scene.fixtures].set(fixtures[:, 3:]),
            )
            data = mjx.kinematics(model, data)
            body = self._scene.visual.light_bodyid  # lights are fixed to their bodies
            axes = data.xmat[body]
            at = data.xpos[body] + (axes @ model.light_pos[..., None])[..., 0]
            return data.geom_xpos, data.geom_xmat, at, (axes @ model.light_dir[..., None])[..., 0]

        with jax.default_matmul_precision("highest"):
            positions, rotations, lights, directions = jax.vmap(poses)(view.qpos, view.fixtures)
        return Inputs(
            positions=positions,
            rotations=rotations,
            sizes=sizes.at[:, self._varied].set(view.geom_size),
            eye=eye,
            axes=axes,
            intrinsics=intrinsics,
            light_positions=lights,
            light_directions=directions,
        )

    def _cameras(self, view: View) -> tuple[Array, Array, Array]:
        """Positions, axes and intrinsics of the cameras, in the kernel's terms."""
        xp = array_namespace(view.K)
        eye, axes = to_mujoco(view.world_from_camera)
        K = view.K * self._samples
        middle = np.array(self._size[::-1]) / 2
        intrinsics = xp.stack([K[:, 0, 0], K[:, 1, 1], *(middle - K[:, :2, 2]).T], -1)
        return eye, axes.reshape(-1, 3, 3), intrinsics
