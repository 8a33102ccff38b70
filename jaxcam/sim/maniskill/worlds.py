"""Worlds that a child process steps: each by itself on the CPU, or all at once on a card."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxcam.sim.maniskill.memory import JOINTS, Sizes
from jaxcam.sim.types import Start

CONTROL_MODE = "pd_joint_pos"


@dataclass(frozen=True)
class Assignment:
    """What a child process is given to do, once, at its start."""

    env: str
    scene: str
    on_gpu: bool
    """Whether physics runs on a card, for all worlds at once; they are drawn at once, too."""
    device: str
    """Where pictures are drawn: ManiSkill's `cpu` or `gpu`."""
    sizes: Sizes


def open_env(to: Assignment, width: int, eye: tuple[int, int] | None = None) -> Any:
    """A new environment of `width` worlds, drawn if it has an eye; see `envs.JaxcamEnv`."""
    import gymnasium  # like SAPIEN below, of the optional extra `maniskill`

    import jaxcam.sim.maniskill.envs  # noqa: F401  (registers the environments)

    env: Any = gymnasium.make(
        to.env,
        scene=to.scene,
        eye=eye,
        num_envs=width,
        sim_backend="physx_cuda" if to.on_gpu else "physx_cpu",
        render_backend=to.device if eye else "none",
        obs_mode="none",
        control_mode=CONTROL_MODE,
    )
    env.reset(seed=0)
    return env.unwrapped


def _unseen(states: np.ndarray, sizes: Sizes) -> tuple[Start, np.ndarray]:
    """Start and velocities of worlds that are not drawn: what is only seen is at the origin."""
    nowhere = np.tile([0, 0, 0, 1.0, 0, 0, 0], (len(states), sizes.fixtures, 1))
    qpos, qvel = np.split(states, [sizes.nq], -1)
    return Start(qpos, np.zeros((len(states), 0, 3)), nowhere), qvel


class SeparateWorlds:
    """Each an environment of its own, stepped on the CPU by the parts that SAPIEN knows.

    A state is qpos and qvel, one after the other.

    Args:
        to: What they are.
    """

    def __init__(self, to: Assignment) -> None:
        self._to = to
        self._worlds: list[_World] = []

    @property
    def width(self) -> int:
        """How many there are; none at first."""
        return len(self._worlds)

    @property
    def env(self) -> Any:
        """An environment that describes them."""
        return self._worlds[0].env

    def grow(self, width: int) -> None:
        """Adds one, on the way to `width` of them."""
        self._worlds.append(_World(self._to))

    def load(self, rows: np.ndarray, states: np.ndarray) -> None:
        """Puts worlds [n] at states [n, nq + nv]."""
        for row, state in zip(rows, states, strict=True):
            self._worlds[row].load(state)

    def step(self, rows: np.ndarray, targets: np.ndarray) -> None:
        """One control step of worlds [n] towards joint targets (rad, m) [n, 9]."""
        for row, target in zip(rows, targets, strict=True):
            self._worlds[row].step(target)

    def read(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """States of worlds [n], and poses (xyz, wxyz) of the grip [n, 7]."""
        worlds = [self._worlds[row] for row in rows]
        return np.array([w.state for w in worlds]), np.array([w.grip for w in worlds])


class _World:
    """One environment: its parts as SAPIEN knows them, without ManiSkill's batches of tensors."""

    def __init__(self, to: Assignment) -> None:
        import sapien  # of an optional extra

        self.env = env = open_env(to, 1)
        self._sizes = to.sizes
        self._substeps = env.sim_freq // env.control_freq
        self._robot = env.agent.robot._objs[0]
        self._joints = self._robot.active_joints
        self._tcp = env.agent.tcp._objs[0]
        self._actors = [actor._objs[0] for actor in env.actors]
        body = sapien.physx.PhysxRigidDynamicComponent
        self._bodies = [actor.find_component_by_type(body) for actor in self._actors]
        self._scene, self._physics = env.scene.sub_scenes[0], env.scene.px
        kinds = sapien.physx.PhysxBaseComponent
        self._touched = [
            entity
            for entity in self._scene.entities
            if any(isinstance(part, kinds) for part in entity.components)
        ]
        self._look()

    def load(self, state: np.ndarray) -> None:
        self._renew()
        start, qvel = _unseen(state[None], self._sizes)
        self.env.begin(start, qvel=qvel)
        for body in self._bodies:
            body.wake_up()
        self._look()

    def step(self, targets: np.ndarray) -> None:
        for joint, target in zip(self._joints, targets, strict=True):
            joint.set_drive_target(target)
        for _ in range(self._substeps):
            self._physics.step()
        self._look()

    def _renew(self) -> None:
        """Moves everything into a new PhysX scene.

        The order in which PhysX solves contacts follows from all the contacts that a scene has
        ever had: the same episode would end otherwise the second time.
        """
        import sapien  # of an optional extra

        physics = sapien.physx.PhysxCpuSystem()
        physics.timestep = self._physics.timestep
        scene = sapien.Scene([physics])
        for entity in self._touched:
            self._scene.remove_entity(entity)
        for entity in self._touched:
            scene.add_entity(entity)
        self._scene, self._physics = scene, physics

    def _look(self) -> None:
        poses = [x for actor in self._actors for x in (actor.pose.p, actor.pose.q)]
        moves = [x for b in self._bodies for x in (b.linear_velocity, b.angular_velocity)]
        self.state = np.concatenate([self._robot.qpos, *poses, self._robot.qvel, *moves])
        self.grip = np.concatenate([self._tcp.pose.p, self._tcp.pose.q])


class BatchedWorlds:
    """One environment of many worlds, all stepped at once by ManiSkill, on a card; else the same.

    Worlds that are not asked for run on, unheeded. One that diverges is put back to where it began,
    not to disturb the others.

    Args:
        to: What they are.
    """

    def __init__(self, to: Assignment) -> None:
        self._to = to
        self._env: Any = None
        self._states = self._rest = self._grips = self._targets = np.zeros((0, 0))

    @property
    def width(self) -> int:
        """See `SeparateWorlds`."""
        return len(self._states)

    @property
    def env(self) -> Any:
        """See `SeparateWorlds`."""
        return self._env

    def grow(self, width: int) -> None:
        """Makes all of them anew: PhysX wants to know how many they are when it starts."""
        if self._env is not None:
            self._env.close()
        self._env = open_env(self._to, width)
        self._look()
        self._rest, self._targets = self._states, self._states[:, :JOINTS].copy()

    def load(self, rows: np.ndarray, states: np.ndarray) -> None:
        """See `SeparateWorlds`."""
        whole = np.isfinite(self._states).all(-1, keepdims=True)
        asked = np.where(whole, self._states, self._rest)
        asked[rows] = states
        self._env.put(*_unseen(asked, self._to.sizes))
        self._look()

    def step(self, rows: np.ndarray, targets: np.ndarray) -> None:
        """See `SeparateWorlds`."""
        if not np.isfinite(self._states).all():
            self.load(rows, self._states[rows])
        self._targets[rows] = targets
        self._env.advance(self._targets)
        self._look()

    def read(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `SeparateWorlds`."""
        return self._states[rows], self._grips[rows]

    def _look(self) -> None:
        qpos, qvel, self._grips = self._env.numbers()
        self._states = np.concatenate([qpos, qvel], -1)
