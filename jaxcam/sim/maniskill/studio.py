"""What draws in a child process: an environment that is put into states and never stepped."""

from typing import Any, NamedTuple

import numpy as np

from jaxcam.sim.maniskill.memory import FAR, NEAR
from jaxcam.sim.maniskill.worlds import Assignment, open_env
from jaxcam.sim.types import Start

SHADER = "minimal"
"""ManiSkill's own choice for its cameras."""
LIGHT = 2
"""Which meshes `jaxcam.sim.maniskill.meshes` makes; goes up with each change of it, since pictures
are named after it."""
CAMERA_ERROR = 1e-3
"""Largest difference (pixels, m) between the camera asked and the one SAPIEN says it has."""


class Asked(NamedTuple):
    """Views to draw, as `jaxcam.sim.types.View` has them."""

    qpos: np.ndarray
    fixtures: np.ndarray
    K: np.ndarray
    camera: np.ndarray


class Studio:
    """Worlds with an eye each, all of which take their pictures at once.

    On the CPU there is one world, and its eye is given the intrinsics of each picture. On a card
    there are as many as the largest batch, and SAPIEN settles intrinsics with the first picture.

    Args:
        to: The worlds.
        height: Of pictures (pixels).
        width: Of pictures (pixels).
        K: Intrinsics of a batch [n, 3, 3].
    """

    def __init__(self, to: Assignment, height: int, width: int, K: np.ndarray) -> None:
        self._on_gpu, self._size = to.on_gpu, (height, width)
        self._K = K[: None if to.on_gpu else 1].copy()
        self._env = open_env(to, len(self._K), self._size)
        self._eyes: Any = self._env.scene.sensors["eye"].camera
        self._shown: tuple[bytes, bytes] | None = None
        self._set_intrinsics(self._K)

    def suits(self, height: int, width: int, K: np.ndarray) -> bool:
        """Whether it can draw such a batch."""
        if self._size != (height, width):
            return False
        return not self._on_gpu or (len(K) <= len(self._K) and (self._K[: len(K)] == K).all())

    def close(self) -> None:
        """Lets go of the environment."""
        self._env.close()

    @property
    def batch(self) -> int:
        """Pictures taken at once."""
        return len(self._K)

    def draw(self, asked: Asked, *, layers: bool) -> tuple[np.ndarray, ...]:
        """Pictures uint8 [n, H, W, 3] of at most `batch` views; depths and segments for layers."""
        count = len(asked.K)
        full = np.minimum(np.arange(self.batch), count - 1)
        self._arrange(Asked(*(x[full] for x in asked)))
        self._eyes.take_picture()
        rgb = self._texture("Color")[:count, ..., :3]
        if not layers:
            return (rgb,)
        texture = self._texture("PositionSegmentation")[:count]
        depth = -texture[..., 2].astype(np.float32) / 1000  # millimetres, camera looks along -z
        return rgb, np.where(depth > 0, depth, np.inf), texture[..., 3].astype(np.int32)

    def segments(self) -> list[str]:
        """Names of what is hit, by number."""
        names = {0: "nothing"}
        for entity in self._env.scene.sub_scenes[0].entities:
            names[entity.per_scene_id] = entity.name
        return [names.get(i, "") for i in range(max(names) + 1)]

    def _arrange(self, asked: Asked) -> None:
        """Shows states to cameras, which are checked against what SAPIEN says."""
        shown = (asked.qpos.tobytes(), asked.fixtures.tobytes())
        start = Start(asked.qpos, np.zeros((len(asked.qpos), 0, 3)), asked.fixtures)
        self._env.show(None if shown == self._shown else start, asked.camera)
        self._shown = shown
        if not self._on_gpu:
            self._set_intrinsics(asked.K)
        self._env.scene.update_render(update_human_render_cameras=False)
        K = np.array([camera.get_intrinsic_matrix() for camera in self._eyes._render_cameras])
        camera_from_world = self._eyes.get_extrinsic_matrix().cpu().numpy().astype(float)[:, :3]
        wrong = abs(camera_from_world @ asked.camera - np.eye(4)[:3]).max((1, 2))
        wrong = np.maximum(wrong, abs(K - asked.K).max((1, 2)))
        if not wrong.max() < CAMERA_ERROR:
            worst = int(np.argmax(wrong))
            raise ValueError(
                f"SAPIEN's camera is not the one that was asked: it differs by {wrong[worst]:g}.\n"
                f"Asked K {asked.K[worst].tolist()}, pose {asked.camera[worst].tolist()}."
            )

    def _set_intrinsics(self, K: np.ndarray) -> None:
        for camera, k in zip(self._eyes._render_cameras, K, strict=True):
            camera.set_perspective_parameters(
                NEAR, FAR, k[0, 0], k[1, 1], k[0, 2], k[1, 2], k[0, 1]
            )

    def _texture(self, name: str) -> np.ndarray:
        if self._on_gpu:
            return self._eyes.get_picture(name)[0].cpu().numpy()
        return self._eyes._render_cameras[0].get_picture(name)[None]
