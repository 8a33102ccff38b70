"""Physics by MuJoCo's C library, a batch of worlds spread over threads."""

import itertools
import logging
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import mujoco
import numba
import numpy as np
from mujoco.batch import Batch
from numba.extending import overload, register_jitable

from jaxcam.sim import controllers
from jaxcam.sim.controllers import Sensed
from jaxcam.sim.engine import Engine
from jaxcam.sim.mujoco.bodies import box_inertia, full_from_sparse
from jaxcam.sim.mujoco.scene import Scene
from jaxcam.sim.types import Command, ControllerName, Start, State

TOGETHER = 16
"""Worlds that go through a control step together, at most: few enough that their data stays in a
core's cache, enough to share the fixed cost of a call."""
LEAST = 4
"""Worlds that a further thread is worth: with fewer, threads only wait for each other's calls."""
_BAD = [
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
    int(mujoco.mjtWarning.mjWARN_BADCTRL),
]
_VELOCITY = mujoco.mjtStage.mjSTAGE_VEL.value


@overload(controllers.solve)
def _solve(matrix: np.ndarray, vector: np.ndarray) -> Callable[..., np.ndarray]:
    # No LAPACK: it takes longer to be called than to solve, and raises for one bad world of many.
    if vector.ndim == 1:

        def compiled(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
            return _eliminate(matrix.copy(), vector.copy().reshape(-1, 1)).reshape(-1)
    else:

        def compiled(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
            return _eliminate(matrix.copy(), vector.copy())

    return compiled


@register_jitable
def _eliminate(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Turns `b` into the solution of `a @ x = b`, `a` being positive definite; both are used up."""
    size, columns = b.shape
    for i in range(size):
        for j in range(i + 1, size):
            factor = a[j, i] / a[i, i]
            for k in range(i + 1, size):
                a[j, k] -= factor * a[i, k]
            for k in range(columns):
                b[j, k] -= factor * b[i, k]
    for i in range(size - 1, -1, -1):
        for k in range(columns):
            for j in range(i + 1, size):
                b[i, k] -= a[i, j] * b[j, k]
            b[i, k] /= a[i, i]
    return b


@overload(controllers.join)
def _join(first: np.ndarray, second: np.ndarray) -> Callable[..., np.ndarray]:
    def compiled(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return np.concatenate((first, second))

    return compiled


for _part in (
    controllers.osc_pose,
    controllers.joint_position,
    controllers.rotation_error,
    controllers.sense,
):
    register_jitable(_part)
_compile = numba.njit(nogil=True, cache=True, error_model="numpy")
TORQUES = {
    "osc_pose": _compile(controllers.pose_torques),
    "joint_position": _compile(controllers.joint_torques),
}
"""Compiled at first use, then kept on disk. Numba looks at the file of these functions only: who
changes what they are given here must delete `jaxcam/sim/__pycache__`."""


class NativeEngine(Engine):
    """Steps worlds with MuJoCo's `Batch`, and the controller, compiled by Numba, between the steps.

    Each thread owns a contiguous share of the batch and takes it, some worlds at a time, through
    all substeps of a control step. Physics and controller release the GIL. The controller runs at
    every substep, as robosuite's does.

    Args:
        scene: Whose physics model is stepped.
        controller: `osc_pose` or `joint_position`.
        varied: Geoms whose sizes differ between episodes (`Start.geom_size`); each must be the only
            geom with mass of its body, which must be a box of uniform density.
        threads: Number of threads; the machine's cores when None.
    """

    def __init__(
        self,
        scene: Scene,
        controller: ControllerName = "osc_pose",
        varied: Sequence[str] = (),
        threads: int | None = None,
    ) -> None:
        if mujoco.get_mju_user_warning() is None:
            # Else MuJoCo writes a file MUJOCO_LOG.TXT wherever one stands.
            mujoco.set_mju_user_warning(logging.getLogger(__name__).warning)
        self.scene = scene
        self.controller: ControllerName = controller
        self.substeps = round(1 / controllers.CONTROL_HZ / scene.physics.opt.timestep)
        self._threads = threads or os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(self._threads)
        self._varied = [scene.physics.geom(name).id for name in varied]
        self.shares: list[Share] = []
        self._places: list[slice] = []

    def reset(self, start: Start) -> State:
        """Puts a batch of worlds at their starts; see `Engine.reset`."""
        count, model = len(start.qpos), self.scene.physics
        if not self._places or self._places[-1].stop != count:
            self._split(count)
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
        for share, place in zip(self.shares, self._places, strict=True):
            part = State(*(x[place] for x in state))
            share.resize(self._varied, start.geom_size[place])
            everyone = np.arange(len(part.ok), dtype=np.int32)
            share.load(everyone, part, afresh=True)
            share.store(everyone, part)
        return state

    def step(self, state: State, command: Command, active: np.ndarray | None = None) -> State:
        """Advances the worlds one control step; see `Engine.step`."""
        if not self._places:
            raise RuntimeError("NativeEngine.step needs a batch of worlds: call reset first.")
        run = state.ok if active is None else state.ok & active
        new = State(*(np.copy(x) for x in state))
        gripper = np.asarray(command.gripper, float)
        closed = controllers.gripper_command(state.closed, gripper)
        new.closed[run] = closed[run]
        target = np.asarray(command.target, float)
        work = [
            self._pool.submit(
                self._advance,
                share,
                State(*(x[place] for x in new)),
                target[place],
                np.flatnonzero(run[place]).astype(np.int32),  # as `Batch` wants them
            )
            for share, place in zip(self.shares, self._places, strict=True)
        ]
        for done in work:
            done.result()
        return new

    def _split(self, count: int) -> None:
        """Shares out `count` worlds."""
        shares = min(self._threads, max(1, count // LEAST))
        edges = np.linspace(0, count, shares + 1).astype(int).tolist()
        self._places = [slice(*ends) for ends in itertools.pairwise(edges)]
        self.shares = [Share(self.scene, place.stop - place.start) for place in self._places]

    def _advance(self, share: "Share", state: State, target: np.ndarray, rows: np.ndarray) -> None:
        """Runs `rows` of a share through one control step, in place."""
        for together in np.array_split(rows, -(-len(rows) // TOGETHER) or 1):
            goal = controllers.goal(self.controller, target[together], state.rest[together])
            goal = tuple(np.ascontiguousarray(x) for x in goal)
            share.load(together, state, afresh=False)
            self._substeps(share, together, goal)
            share.store(together, state)

    def _substeps(self, share: "Share", rows: np.ndarray, goal: tuple[np.ndarray, ...]) -> None:
        torques = TORQUES[self.controller]
        for _ in range(self.substeps):
            share.step(torques, rows, goal)


class Share:
    """The worlds of one thread, between calls always computed up to the velocity stage."""

    def __init__(self, scene: Scene, count: int) -> None:
        model = self._model = scene.physics
        # Two at least: slices of a single row have no gaps, for which Numba would compile anew.
        count = max(count, 2)
        self.batch = batch = Batch(model, count, nthread=1, persistent=True)
        self._arm = slice(int(scene.arm[0]), int(scene.arm[-1]) + 1)
        self._fingers = scene.fingers
        self._mass_at = full_from_sparse(model)[self._arm, self._arm]
        self._sizes: np.ndarray | None = None
        # Live arrays, a row per world. What is computed is bound before the first computation.
        self._state = (batch.qpos, batch.qvel, batch.qacc_warmstart)
        self._ctrl = batch.ctrl
        self._torque = batch.ctrl[:, self._arm]
        self._limits = np.ascontiguousarray(model.actuator_ctrlrange[scene.arm].T)
        self._sensed = Sensed(
            q=batch.qpos[:, self._arm],
            qd=batch.qvel[:, self._arm],
            position=batch.site_xpos[:, scene.grip_site],
            rotation=batch.site_xmat[:, scene.grip_site].reshape(count, 3, 3),
            motion=batch.cdof[:, self._arm],
            origin=batch.subtree_com[:, model.body_rootid[model.site_bodyid[scene.grip_site]]],
            mass=batch.M,
            bias=batch.qfrc_bias[:, self._arm],
        )

    def resize(self, geoms: Sequence[int], sizes: np.ndarray) -> None:
        """Gives boxes new half-sizes, and their bodies the mass and inertia that follow."""
        if self._sizes is not None and np.array_equal(self._sizes, sizes):
            return
        self._sizes = np.array(sizes, float)
        drawn, batch = self._model, self.batch
        for i, geom in enumerate(geoms):
            half = self._sizes[:, i]
            # Of the scene's model, not the last size's: a world's past must leave no rounding.
            body, mass, inertia = box_inertia(drawn, geom, half)
            batch.expand("geom_size")[:, geom] = half
            batch.expand("geom_rbound")[:, geom] = np.linalg.norm(half, axis=-1)
            batch.expand("geom_aabb")[:, geom, 3:] = half
            batch.expand("body_mass")[:, body] = mass
            batch.expand("body_inertia")[:, body] = inertia
        if geoms:
            batch.set_const()

    def load(self, rows: np.ndarray, state: State, *, afresh: bool) -> None:
        """Puts worlds at a state and their fingers' servos at their targets.

        Worlds that are there already are left as they are, unless everything is to be computed
        `afresh`, which gives the same.
        """
        wanted = (state.qpos[rows], state.qvel[rows], state.warmstart[rows])
        moved = np.full(len(rows), afresh)
        for have, want in zip(self._state, wanted, strict=True):
            moved |= (have[rows] != want).any(-1)
            have[rows] = want
        self.batch.warning[rows] = 0
        self._ctrl[rows] = 0
        self._ctrl[rows[:, None], self._fingers] = controllers.finger_targets(state.closed[rows])
        if moved.any():
            self.batch.forward(rows[moved], stage=_VELOCITY)

    def step(
        self, torques: Callable[..., None], rows: np.ndarray, goal: tuple[np.ndarray, ...]
    ) -> None:
        """Advances worlds one substep under the torques of a controller."""
        torques(self._sensed, self._mass_at, rows, goal, self._limits, self._torque)
        self.batch.step(rows, stage=_VELOCITY)

    def diverged(self, rows: np.ndarray) -> np.ndarray:
        """Which worlds MuJoCo has warned of since they were loaded."""
        return self.batch.warning[rows][:, _BAD, 1].any(-1)

    def store(self, rows: np.ndarray, state: State) -> None:
        """Writes where worlds are into a state."""
        for have, out in zip(self._state, (state.qpos, state.qvel, state.warmstart), strict=True):
            out[rows] = have[rows]
        state.grip_position[rows] = self._sensed.position[rows]
        state.grip_rotation[rows] = self._sensed.rotation[rows]
        state.ok[rows] = ~self.diverged(rows) & np.isfinite(state.qpos[rows]).all(-1)
