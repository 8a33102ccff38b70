"""ManiSkill's physics behind the interface of engines: `SapienEngine`."""

from collections.abc import Sequence

import numpy as np

from jaxcam.errors import SimError
from jaxcam.rays.rotations import matrix_from_quaternion, matrix_from_rotvec
from jaxcam.sim.controllers import CONTROL_HZ
from jaxcam.sim.engine import Engine
from jaxcam.sim.maniskill import kinematics
from jaxcam.sim.maniskill.memory import ROWS
from jaxcam.sim.maniskill.pool import Child, Pool, pool_of
from jaxcam.sim.maniskill.scene import SapienWorld
from jaxcam.sim.types import Command, ControllerName, Start, State


class SapienEngine(Engine):
    """Steps worlds with PhysX, spread over child processes.

    Both controllers end in position targets of the joints' drives, as all of ManiSkill's do:
    `joint_position` hands them over (`pd_joint_pos`), `osc_pose` finds those that reach a pose
    (`pd_ee_pose`), from where the arm is. A world that is not where a state says is put there; only
    then is the memory of its contacts lost.

    Args:
        scene: The world.
        controller: `osc_pose` or `joint_position`.
        varied: Geoms whose sizes differ between episodes: none do here.
        on_gpu: Whether physics runs on a card.
        pool: Processes that step it; those that the world's other engines and painters use, when
            None.
    """

    def __init__(
        self,
        scene: SapienWorld,
        controller: ControllerName,
        varied: Sequence[str] = (),
        *,
        on_gpu: bool = False,
        pool: Pool | None = None,
    ) -> None:
        self.scene, self.controller = scene, controller
        self._pool = pool or pool_of(scene, on_gpu=on_gpu)
        about = self._pool.about
        if about["control_hz"] != CONTROL_HZ:
            raise SimError(
                f"{scene.env} has {about['control_hz']:g} control steps a second, expected "
                f"{CONTROL_HZ}."
            )
        self.substeps = int(about["substeps"])
        self._fingers = np.array([about["open"], about["closed"]])

    def reset(self, start: Start) -> State:
        """Puts a batch of worlds at their starts, at rest, gripper open; see `Engine.reset`."""
        count = len(start.qpos)
        state = State(
            qpos=np.empty((count, self.scene.nq)),
            qvel=np.empty((count, self.scene.nv)),
            warmstart=np.empty((count, 0)),
            closed=np.empty(count),
            rest=np.empty((count, len(self.scene.arm))),
            grip_position=np.empty((count, 3)),
            grip_rotation=np.empty((count, 3, 3)),
            ok=np.empty(count, bool),
        )
        self._put_at(state, start, np.arange(count))
        return state

    def restart(self, state: State, start: Start, again: np.ndarray) -> State:
        """Puts some worlds at a start; see `Engine.restart`. The others' contacts are kept."""
        rows = np.flatnonzero(again)
        new = State(*(np.copy(x) for x in state))
        self._put_at(new, start, rows)
        return new

    def _put_at(self, state: State, start: Start, rows: np.ndarray) -> None:
        """Writes the start of some worlds into a state, and puts them there."""
        state.qpos[rows] = start.qpos[rows]
        state.qvel[rows], state.closed[rows], state.ok[rows] = 0, -1, True
        state.rest[rows] = state.qpos[np.ix_(rows, self.scene.arm)]
        self._ask("load", rows, state, None)

    def step(self, state: State, command: Command, active: np.ndarray | None = None) -> State:
        """Advances the worlds one control step; see `Engine.step`."""
        new = State(*(np.copy(x) for x in state))
        rows = np.flatnonzero(state.ok if active is None else state.ok & active)
        if not len(rows):
            return new
        sign = np.sign(np.asarray(command.gripper, float)[rows])
        new.closed[rows] = np.where(sign == 0, state.closed[rows], sign)
        arm = self._arm_targets(state, np.asarray(command.target, float)[rows], rows)
        opened, closed = self._fingers
        finger = opened + (closed - opened) * (new.closed[rows] + 1) / 2
        self._ask("step", rows, new, np.column_stack([arm, finger, finger]))
        return new

    def _arm_targets(self, state: State, target: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Joint angles (rad) [n, 7] of targets [n, 6 or 7]."""
        if self.controller == "joint_position":
            return target
        base = self.scene.world_from_base
        return kinematics.inverse(
            (target[:, :3] - base[:3, 3]) @ base[:3, :3],
            base[:3, :3].T @ matrix_from_rotvec(target[:, 3:]),
            state.qpos[rows][:, self.scene.arm],
            state.rest[rows],
        )

    def _ask(self, what: str, rows: np.ndarray, state: State, targets: np.ndarray | None) -> None:
        """Has children do something with worlds in a state, and writes where they are into it."""
        shares = self._shares(rows, len(state.qpos))
        for child, at, local in shares:
            memory, here = child.memory, rows[at]
            memory.qpos[local], memory.qvel[local] = state.qpos[here], state.qvel[here]
            if targets is not None:
                memory.targets[local] = targets[at]
        self._pool.each([(child, (what, local.tolist())) for child, _, local in shares])
        for child, at, local in shares:
            memory, here = child.memory, rows[at]
            state.qpos[here], state.qvel[here] = memory.qpos_now[local], memory.qvel_now[local]
            grip = memory.grip[local]
            state.grip_position[here] = grip[:, :3]
            state.grip_rotation[here] = matrix_from_quaternion(grip[:, 3:])
            sound = np.isfinite(memory.qpos_now[local]).all(-1)
            state.ok[here] = sound & np.isfinite(memory.qvel_now[local]).all(-1)

    def _shares(self, rows: np.ndarray, count: int) -> list[tuple[Child, np.ndarray, np.ndarray]]:
        """How worlds are shared out.

        Returns:
            For each child that has any of `rows`: the child, the places of its worlds in `rows`,
            and the numbers of these worlds within the child.
        """
        children = self._pool.children(count)
        each = -(-count // len(children))
        if each > ROWS:
            raise SimError(
                f"{count} worlds are too many for {len(children)} processes: at most "
                f"{ROWS * len(children)} at once. Lower --width."
            )
        owner = rows // each
        shares = []
        for i, child in enumerate(children):
            at = np.flatnonzero(owner == i)
            if len(at):
                shares.append((child, at, rows[at] - i * each))
        return shares
