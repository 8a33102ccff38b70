"""Physics by MuJoCo's C library, a batch of worlds spread over threads."""

import copy
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import mujoco
import numpy as np

from jaxcam.rotations import matrix_from_rotvec
from jaxcam.sim import controllers
from jaxcam.sim.controllers import ArmState
from jaxcam.sim.engine import Command, ControllerName, Start, State
from jaxcam.sim.scene import Scene

_BAD = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)


class NativeEngine:
    """Steps worlds with `mj_step1`, a controller batched over worlds, and `mj_step2`.

    Each thread owns a contiguous share of the batch and runs it through all substeps of a control
    step; the C calls release the GIL. The controller runs at every substep, as robosuite's does.

    Args:
        scene: whose physics model is stepped.
        controller: `osc_pose` or `joint_position`.
        varied: geoms whose sizes differ between episodes (`Start.geom_size`); each must be the only
            geom with mass of its body, which must be a box of uniform density.
        threads: number of threads; the machine's cores when None.
    """

    def __init__(
        self,
        scene: Scene,
        controller: ControllerName = "osc_pose",
        varied: Sequence[str] = (),
        threads: int | None = None,
    ) -> None:
        self.scene = scene
        self.controller: ControllerName = controller
        self.substeps = round(1 / controllers.CONTROL_HZ / scene.physics.opt.timestep)
        self._threads = threads or os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(self._threads)
        self._varied = [scene.physics.geom(name).id for name in varied]
        self._limits = scene.physics.actuator_ctrlrange[scene.arm].T
        self._worlds: list[_World] = []

    def reset(self, start: Start) -> State:
        """Puts a batch of worlds at their starts; see `Engine.reset`."""
        count, model = len(start.qpos), self.scene.physics
        while len(self._worlds) < count:
            self._worlds.append(_World(self.scene, own_model=bool(self._varied)))
        for world, sizes in zip(self._worlds[:count], start.geom_size, strict=True):
            world.resize(self._varied, sizes)
        state = State(
            qpos=np.array(start.qpos, float),
            qvel=np.zeros((count, model.nv)),
            warmstart=np.zeros((count, model.nv)),
            closed=np.zeros(count),
            rest=np.array(start.qpos, float)[:, self.scene.arm],
            grip_position=np.empty((count, 3)),
            grip_rotation=np.empty((count, 3, 3)),
            ok=np.ones(count, bool),
        )
        for i, world in enumerate(self._worlds[:count]):
            world.load(state, i)
            world.store(state, i)
        return state

    def step(self, state: State, command: Command, active: np.ndarray | None = None) -> State:
        """Advances the worlds one control step; see `Engine.step`."""
        run = state.ok if active is None else state.ok & active
        new = State(*(np.copy(x) for x in state))
        gripper = np.asarray(command.gripper, float)
        closed = controllers.gripper_command(state.closed, gripper)
        new.closed[run] = closed[run]
        target = np.asarray(command.target, float)
        shares = np.array_split(np.flatnonzero(run), self._threads)
        work = [
            self._pool.submit(self._advance, share, new, target[share])
            for share in shares
            if len(share)
        ]
        for share in work:
            share.result()
        return new

    def _advance(self, share: np.ndarray, state: State, target: np.ndarray) -> None:
        """Runs the worlds `share` through one control step, in place."""
        worlds = [self._worlds[i] for i in share]
        arm, n = self.scene.arm, len(worlds)
        for world, i in zip(worlds, share, strict=True):
            world.load(state, i)
            world.data.ctrl[self.scene.fingers] = controllers.finger_targets(state.closed[i])
        read = _ArmBuffers(n, self.scene.physics.nv)
        rest = state.rest[share]
        rotation = matrix_from_rotvec(target[:, 3:]) if self.controller == "osc_pose" else None
        for _ in range(self.substeps):
            for k, world in enumerate(worlds):
                mujoco.mj_step1(world.model, world.data)
                world.read(read, k)
            now = read.arm_state(arm)
            try:
                torque = self._torque(now, target, rotation, rest)
            except np.linalg.LinAlgError:
                # MuJoCo puts a world that diverges to its zero pose, where the arm is singular.
                for k in np.flatnonzero([w.has_diverged() for w in worlds]).tolist():
                    read.stand_in(k)
                torque = self._torque(now, target, rotation, rest)
            torque = np.clip(torque, *self._limits)
            for k, world in enumerate(worlds):
                world.arm_ctrl[:] = torque[k]
                mujoco.mj_step2(world.model, world.data)
        for world, i in zip(worlds, share, strict=True):
            world.store(state, i)

    @staticmethod
    def _torque(
        now: ArmState, target: np.ndarray, rotation: np.ndarray | None, rest: np.ndarray
    ) -> np.ndarray:
        if rotation is None:
            return controllers.joint_position(now, target)
        return controllers.osc_pose(now, target[:, :3], rotation, rest)


class _World:
    """One MjData, with its own model where sizes vary; arrays are views made once."""

    def __init__(self, scene: Scene, *, own_model: bool) -> None:
        self.model = copy.copy(scene.physics) if own_model else scene.physics
        self.data = mujoco.MjData(self.model)
        self._scene_model = scene.physics
        self._site = scene.grip_site
        self._size: np.ndarray | None = None
        data = self.data
        first, last = int(scene.arm[0]), int(scene.arm[-1]) + 1
        self.arm_ctrl = data.ctrl[first:last]
        self._q, self._qd = data.qpos[first:last], data.qvel[first:last]
        self._bias = data.qfrc_bias[first:last]
        self._position = data.site_xpos[self._site]
        self._rotation = data.site_xmat[self._site].reshape(3, 3)

    def resize(self, geoms: Sequence[int], sizes: np.ndarray) -> None:
        """Gives boxes new half-sizes, and their bodies the mass and inertia that follow."""
        if self._size is not None and np.array_equal(self._size, sizes):
            return
        self._size = np.array(sizes, float)
        for geom, half in zip(geoms, self._size, strict=True):
            body = self.model.geom_bodyid[geom]
            # Of the scene's model, not the last size's: a world's past must leave no rounding.
            drawn = self._scene_model
            density = drawn.body_mass[body] / (8 * drawn.geom_size[geom].prod())
            self.model.geom_size[geom] = half
            self.model.geom_rbound[geom] = np.linalg.norm(half)
            self.model.geom_aabb[geom, 3:] = half
            mass = 8 * half.prod() * density
            self.model.body_mass[body] = mass
            self.model.body_inertia[body] = mass / 3 * ((half**2).sum() - half**2)
        mujoco.mj_setConst(self.model, self.data)

    def load(self, state: State, i: int) -> None:
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = state.qpos[i]
        self.data.qvel[:] = state.qvel[i]
        self.data.qacc_warmstart[:] = state.warmstart[i]

    def has_diverged(self) -> bool:
        return any(self.data.warning[w].number for w in _BAD)

    def store(self, state: State, i: int) -> None:
        data = self.data
        state.ok[i] = not self.has_diverged() and bool(np.isfinite(data.qpos).all())
        state.qpos[i], state.qvel[i] = data.qpos, data.qvel
        state.warmstart[i] = data.qacc_warmstart
        mujoco.mj_kinematics(self.model, data)
        state.grip_position[i], state.grip_rotation[i] = self._position, self._rotation

    def read(self, out: "_ArmBuffers", k: int) -> None:
        out.q[k], out.qd[k], out.bias[k] = self._q, self._qd, self._bias
        out.position[k], out.rotation[k] = self._position, self._rotation
        mujoco.mj_jacSite(self.model, self.data, out.jacp[k], out.jacr[k], self._site)
        mujoco.mj_fullM(self.model, self.data, out.mass[k])


class _ArmBuffers:
    """Where worlds write what the controller reads, so that it is batched without copies."""

    def __init__(self, n: int, nv: int) -> None:
        self.q, self.qd, self.bias = np.empty((n, 7)), np.empty((n, 7)), np.empty((n, 7))
        self.position, self.rotation = np.empty((n, 3)), np.empty((n, 3, 3))
        self.jacobian = np.empty((n, 6, nv))
        self.jacp, self.jacr = self.jacobian[:, :3], self.jacobian[:, 3:]
        self.mass = np.empty((n, nv, nv))

    def stand_in(self, k: int) -> None:
        """Makes row `k` one that any controller can solve; its world is lost."""
        self.mass[k] = np.eye(self.mass.shape[-1])
        self.jacobian[k] = np.eye(*self.jacobian.shape[-2:])

    def arm_state(self, arm: np.ndarray) -> ArmState:
        first, last = int(arm[0]), int(arm[-1]) + 1
        return ArmState(
            q=self.q,
            qd=self.qd,
            position=self.position,
            rotation=self.rotation,
            jacobian=self.jacobian[:, :, first:last],
            mass=self.mass[:, first:last, first:last],
            bias=self.bias,
        )
