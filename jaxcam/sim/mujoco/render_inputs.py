"""Views in the ray tracer's terms: where every geom, light and camera is."""

from typing import Any, NamedTuple

import mujoco
import numpy as np

from jaxcam.rays import to_mujoco
from jaxcam.rays.rotations import Array, array_namespace
from jaxcam.sim.mujoco.scene import Scene
from jaxcam.sim.types import View


class Inputs(NamedTuple):
    """What a ray tracer reads of each world, float32, batch first."""

    positions: Any
    rotations: Any
    sizes: Any
    eye: Any
    axes: Any
    intrinsics: Any
    light_positions: Any
    light_directions: Any


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
        self.scene, self.varied = scene, varied
        self._size, self._samples = size, samples
        self._data = mujoco.MjData(scene.visual)

    def on_host(self, view: View) -> Inputs:
        """Poses by MuJoCo's kinematics, cameras in MuJoCo's axes, intrinsics in its terms."""
        model, data, count = self.scene.visual, self._data, len(view.qpos)
        sizes = np.repeat(model.geom_size[None], count, 0)
        sizes[:, self.varied] = view.geom_size
        eye, axes, intrinsics = self.cameras(
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
            data.mocap_pos[self.scene.fixtures] = view.fixtures[i, :, :3]
            data.mocap_quat[self.scene.fixtures] = view.fixtures[i, :, 3:]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_camlight(model, data)
            inputs.positions[i] = data.geom_xpos
            inputs.rotations[i] = data.geom_xmat.reshape(-1, 3, 3)
            inputs.light_positions[i], inputs.light_directions[i] = data.light_xpos, data.light_xdir
        return inputs

    def cameras(self, view: View) -> tuple[Array, Array, Array]:
        """Positions, axes and intrinsics of the cameras, in the kernel's terms."""
        xp = array_namespace(view.K)
        eye, axes = to_mujoco(view.world_from_camera)
        K = view.K * self._samples
        middle = np.array(self._size[::-1]) / 2
        intrinsics = xp.stack([K[:, 0, 0], K[:, 1, 1], *(middle - K[:, :2, 2]).T], -1)
        return eye, axes.reshape(-1, 3, 3), intrinsics


def shrunk(pictures: Any, samples: int) -> Any:
    """Pictures uint8 [B, H, W, 3] of which each pixel is the mean of `samples` x `samples`."""
    if samples == 1:
        return pictures
    count, height, width, _ = pictures.shape
    shape = (count, height // samples, samples, width // samples, samples, 3)
    return pictures.reshape(shape).mean((2, 4)).round().astype(np.uint8)
