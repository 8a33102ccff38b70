"""The child process: worlds of one ManiSkill environment, and what draws them.

Started by `jaxcam.sim.maniskill.pool` as `python -m jaxcam.sim.maniskill.worker`. It answers
requests that come through a pipe, with arrays in shared memory. Each world is an environment of its
own, stepped and never drawn; one more is drawn and never stepped.
"""

import faulthandler
import json
import signal
import sys
import traceback
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from jaxcam.rays import sapien_from_opencv
from jaxcam.sim.engine import Start
from jaxcam.sim.maniskill.memory import FAR, JOINTS, NEAR, Memory, Sizes, open_memory

CONTROL_MODE = "pd_joint_pos"
SHADER = "minimal"
"""ManiSkill's own choice for its cameras."""
CAMERA_ERROR = 1e-3
"""Largest difference (pixels, m) between the camera asked and the one SAPIEN says it has."""


@dataclass(frozen=True)
class Assignment:
    """What the parent tells its child at the start."""

    env: str
    scene: str
    device: str
    """Where pictures are drawn: ManiSkill's `cpu` or `gpu`."""
    sizes: Sizes


class _World:
    """One environment: its parts as SAPIEN knows them, without ManiSkill's batches of tensors."""

    def __init__(self, to: Assignment, *, drawn: bool) -> None:
        import gymnasium
        import sapien

        env: Any = gymnasium.make(
            to.env,
            scene=to.scene,
            num_envs=1,
            sim_backend="physx_cpu",
            render_backend=to.device if drawn else "none",
            obs_mode="none",
            control_mode=CONTROL_MODE,
        )
        env.reset(seed=0)
        self.env = env = env.unwrapped
        self.substeps = env.sim_freq // env.control_freq
        self.robot = env.agent.robot._objs[0]
        self.joints = self.robot.active_joints
        self.grip = env.agent.tcp._objs[0]
        self.actors = [actor._objs[0] for actor in env.actors]
        body = sapien.physx.PhysxRigidDynamicComponent
        self.bodies = [actor.find_component_by_type(body) for actor in self.actors]
        self.last: np.ndarray | None = None
        self._scene, self._physics = env.scene.sub_scenes[0], env.scene.px
        kinds = sapien.physx.PhysxBaseComponent
        self._touched = [
            entity
            for entity in self._scene.entities
            if any(isinstance(part, kinds) for part in entity.components)
        ]

    def put(self, qpos: np.ndarray, fixtures: np.ndarray) -> None:
        """At rest, and what is seen where it is seen."""
        self.env.begin(Start(qpos[None], np.zeros((1, 0, 3)), fixtures[None]))

    def load(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """A state; what is only seen does not matter to the physics and is left at the origin."""
        self._renew()
        self.put(qpos, np.tile([0, 0, 0, 1.0, 0, 0, 0], (2 + len(self.env.markers), 1)))
        self.robot.set_qvel(qvel[:JOINTS])
        for body, velocity in zip(self.bodies, qvel[JOINTS:].reshape(-1, 6), strict=True):
            body.set_linear_velocity(velocity[:3])
            body.set_angular_velocity(velocity[3:])
            body.wake_up()
        self.aim(qpos[:JOINTS])

    def aim(self, targets: np.ndarray) -> None:
        for joint, target in zip(self.joints, targets, strict=True):
            joint.set_drive_target(target)

    def step(self) -> None:
        for _ in range(self.substeps):
            self._physics.step()

    def _renew(self) -> None:
        """Moves everything into a new PhysX scene.

        The order in which PhysX solves contacts follows from all the contacts that a scene has
        ever had: the same episode would end otherwise the second time.
        """
        import sapien

        physics = sapien.physx.PhysxCpuSystem()
        physics.timestep = self._physics.timestep
        scene = sapien.Scene([physics])
        for entity in self._touched:
            self._scene.remove_entity(entity)
        for entity in self._touched:
            scene.add_entity(entity)
        self._scene, self._physics = scene, physics

    def read(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        poses = [x for actor in self.actors for x in (actor.pose.p, actor.pose.q)]
        moves = [x for b in self.bodies for x in (b.linear_velocity, b.angular_velocity)]
        grip = self.grip.pose
        return (
            np.concatenate([self.robot.qpos, *poses]),
            np.concatenate([self.robot.qvel, *moves]),
            np.concatenate([grip.p, grip.q]),
        )


class Worker:
    """Answers requests; each is a method here.

    Args:
        to: what it is for.
        memory: shared with the parent.
    """

    def __init__(self, to: Assignment, memory: Memory) -> None:
        import jaxcam.sim.maniskill.envs  # noqa: F401  (registers the environments)

        self._to, self._memory = to, memory
        self._worlds: list[_World] = []
        self._studio: _Studio | None = None

    def hello(self) -> dict[str, float]:
        """How far (m) fingers are told to open and close, and the steps of a second."""
        self._worlds.append(_World(self._to, drawn=False))
        env = self._worlds[0].env
        gripper = env.agent.controllers[CONTROL_MODE].configs["gripper"]
        return {
            "open": gripper.upper,
            "closed": gripper.lower,
            "control_hz": env.control_freq,
            "substeps": self._worlds[0].substeps,
        }

    def load(self, rows: list[int]) -> None:
        """Puts worlds at the states asked, whatever they did before."""
        memory = self._memory
        while len(self._worlds) <= max(rows):
            self._worlds.append(_World(self._to, drawn=False))
            memory.beat[0] += 1
        for i in rows:
            self._worlds[i].load(memory.qpos[i], memory.qvel[i])
            self._store(i)

    def step(self, rows: list[int]) -> None:
        """One control step of worlds, from the states asked to the targets asked."""
        memory = self._memory
        elsewhere = [i for i in rows if not self._is_there(i)]
        if elsewhere:
            self.load(elsewhere)
        for i in rows:
            self._worlds[i].aim(memory.targets[i])
            self._worlds[i].step()
            self._store(i)

    def draw(self, count: int, height: int, width: int, layers: bool) -> list[str]:
        """Draws the first `count` views asked.

        Returns:
            Names of the segments, by their number; none unless asked for layers.
        """
        if self._studio is None:
            self._studio = _Studio(self._to)
        memory, studio = self._memory, self._studio
        pictures, depths, segments = memory.layers(count, height, width)
        for i in range(count):
            studio.arrange(memory.qpos[i], memory.fixtures[i])
            camera = studio.camera(height, width, memory.K[i], memory.camera[i])
            camera.take_picture()
            pictures[i] = camera.get_picture("Color")[..., :3]
            if layers:
                depths[i], segments[i] = _depth_and_segments(camera)
            memory.beat[0] += 1
        return studio.segments() if layers else []

    def _is_there(self, i: int) -> bool:
        last = self._worlds[i].last if i < len(self._worlds) else None
        asked = np.concatenate([self._memory.qpos[i], self._memory.qvel[i]])
        return last is not None and np.array_equal(asked, last)

    def _store(self, i: int) -> None:
        memory = self._memory
        memory.qpos_now[i], memory.qvel_now[i], memory.grip[i] = self._worlds[i].read()
        self._worlds[i].last = np.concatenate([memory.qpos_now[i], memory.qvel_now[i]])
        memory.beat[0] += 1


class _Studio:
    """The environment that is drawn, and its camera."""

    def __init__(self, to: Assignment) -> None:
        import sapien

        self._world = _World(to, drawn=True)
        self._scene = self._world.env.scene.sub_scenes[0]
        self._shown: tuple[bytes, bytes] | None = None
        self._size: tuple[int, int] | None = None
        self._mount = sapien.Entity()
        self._camera: Any = None
        self._pose: Any = sapien.Pose

    def arrange(self, qpos: np.ndarray, fixtures: np.ndarray) -> None:
        """Shows a state; nothing is done when it is shown already."""
        shown = (qpos.tobytes(), fixtures.tobytes())
        if shown != self._shown:
            self._world.put(qpos, fixtures)
            self._shown = shown

    def camera(self, height: int, width: int, K: np.ndarray, pose: np.ndarray) -> Any:
        """The camera with these intrinsics at this pose, checked against what SAPIEN says."""
        import sapien

        if self._size != (height, width):
            if self._camera is not None:
                self._scene.remove_entity(self._mount)
            sapien.render.set_camera_shader_dir(SHADER)
            self._camera = sapien.render.RenderCameraComponent(width, height)
            self._mount = sapien.Entity()
            self._mount.add_component(self._camera)
            self._scene.add_entity(self._mount)
            self._size = (height, width)
        camera = self._camera
        camera.set_perspective_parameters(NEAR, FAR, K[0, 0], K[1, 1], K[0, 2], K[1, 2], K[0, 1])
        self._mount.set_pose(sapien.Pose(np.asarray(sapien_from_opencv(pose), float)))
        self._scene.update_render()
        wrong = abs(camera.get_intrinsic_matrix() - K).max()
        camera_from_world = np.asarray(camera.get_extrinsic_matrix(), float)[:3]
        wrong = max(wrong, abs(camera_from_world @ pose - np.eye(4)[:3]).max())
        if not wrong < CAMERA_ERROR:
            raise ValueError(
                f"SAPIEN's camera is not the one that was asked: it differs by {wrong:g}.\n"
                f"Asked K {K.tolist()}, pose {pose.tolist()}."
            )
        return camera

    def segments(self) -> list[str]:
        names = {0: "nothing"}
        for entity in self._scene.entities:
            names[entity.per_scene_id] = entity.name
        return [names.get(i, "") for i in range(max(names) + 1)]


def _depth_and_segments(camera: Any) -> tuple[np.ndarray, np.ndarray]:
    """Planar depth (m), inf where nothing is hit, and ids of entities, of the last picture."""
    layer = camera.get_picture("PositionSegmentation")
    depth = -layer[..., 2].astype(np.float32) / 1000  # millimetres, camera looks along -z
    return np.where(depth > 0, depth, np.inf), layer[..., 3].astype(np.int32)


def main() -> None:
    """The child's life: requests until the parent closes its end."""
    faulthandler.enable()  # a crash in SAPIEN says where
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to answer
    pipe, file, told = Connection(int(sys.argv[1])), int(sys.argv[2]), json.loads(sys.argv[3])
    to = Assignment(**{**told, "sizes": Sizes(**told["sizes"])})
    memory = open_memory(file, to.sizes)
    worker: Worker | None = None
    while True:
        try:
            name, *args = pipe.recv()
        except EOFError:
            return
        try:
            worker = worker or Worker(to, memory)
            pipe.send((True, getattr(worker, name)(*args)))
        except Exception:
            pipe.send((False, traceback.format_exc()))


if __name__ == "__main__":
    main()
