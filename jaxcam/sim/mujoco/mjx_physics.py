"""A control step of MJX: pure functions of a batch of states, to be compiled by who calls them."""

import functools
from collections.abc import Sequence
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from jaxcam.rays.rotations import Array
from jaxcam.sim import controllers
from jaxcam.sim.controllers import ArmState
from jaxcam.sim.mujoco.bodies import full_from_sparse
from jaxcam.sim.mujoco.machine import start_warp
from jaxcam.sim.mujoco.mjx_model import (
    Bodies,
    bare,
    check_pairs,
    filtered,
    pair_count,
    resized,
    suit_warp,
)
from jaxcam.sim.mujoco.mjx_room import LOST_FOR_GOOD
from jaxcam.sim.mujoco.scene import Scene
from jaxcam.sim.types import Command, ControllerName, Start, State

Impl = Literal["jax", "warp"]


class Scratch(NamedTuple):
    """Data that every physics step of a batch starts from."""

    full: mjx.Data
    bare: mjx.Data
    """With no room for contacts."""


class MjxPhysics:
    """The worlds of one scene and controller; it holds the models, and no state.

    Args:
        scene: Whose physics model is stepped.
        controller: `osc_pose` or `joint_position`.
        varied: Geoms whose sizes differ between episodes.
        impl: `warp` or `jax`.

    Raises:
        ConfigError: If MJX-JAX cannot collide two of the scene's geoms.
    """

    def __init__(
        self, scene: Scene, controller: ControllerName, varied: Sequence[str], impl: Impl
    ) -> None:
        self.scene, self.impl = scene, impl
        self.controller: ControllerName = controller
        self.substeps = round(1 / controllers.CONTROL_HZ / scene.physics.opt.timestep)
        self._varied = [scene.physics.geom(name).id for name in varied]
        self._limits = scene.physics.actuator_ctrlrange[scene.arm].T.astype(np.float32)
        self._host_model = model = filtered(scene.physics)
        if impl == "jax":
            check_pairs(model)
        else:
            start_warp()
            suit_warp(model)
        self._body = int(model.site_bodyid[scene.grip_site])
        self._here = jax.local_devices()[0]  # MJX would take the first of all processes' devices
        put = functools.partial(mjx.put_model, device=self._here, impl=impl)
        self.model = put(model)
        if impl == "warp":  # overflows are read from the data; a print from a kernel is no error
            self.model = self.model.tree_replace({"opt._impl.warn_overflow": 0})
        self._bare = self.model if impl == "jax" else put(bare(model))
        self._mass_at = full_from_sparse(model)[np.ix_(scene.arm, scene.arm)]

    @property
    def usual_contacts(self) -> int:
        """Contacts per world, on average over a batch, for which room is made at first."""
        # Time goes with the room. The most that demonstrations need is 40 (Square).
        return min(44, 2 * pair_count(self._host_model) + 2)

    def scratch(self, count: int, contacts: int, rows: int) -> Scratch:
        """Scratch for `count` worlds.

        Args:
            count: Number of worlds.
            contacts: Room for contacts per world, on average over the batch (`warp`).
            rows: Room for constraint rows in each world (`warp`).
        """
        with jax.ensure_compile_time_eval():
            make = functools.partial(mjx.make_data, self._host_model, self._here, impl=self.impl)
            if self.impl == "jax":
                return Scratch(*[make()] * 2)
            return Scratch(make(naconmax=contacts * count, njmax=rows), make(naconmax=1, njmax=1))

    def begin(self, scratch: Scratch, start: Start) -> State:
        """States of worlds at their starts, at rest, gripper half open."""
        qpos = jnp.asarray(start.qpos, jnp.float32)
        count, still = len(qpos), jnp.zeros((len(qpos), self.scene.physics.nv))
        position, rotation = self._grip(scratch, qpos)
        return State(
            qpos=qpos,
            qvel=still,
            warmstart=still,
            closed=jnp.zeros(count),
            rest=qpos[:, self.scene.arm],
            grip_position=position,
            grip_rotation=rotation,
            ok=jnp.ones(count, bool),
        )

    def bodies(self, start: Start) -> Bodies:
        """Fields of the model that differ between worlds."""
        fields = resized(self._host_model, self._varied, start.geom_size)
        return {n: x.reshape(-1, *getattr(self.model, n).shape) for n, x in fields.items()}

    def advance(
        self, scratch: Scratch, bodies: Bodies, state: State, command: Command, active: Array
    ) -> tuple[State, jax.Array]:
        """One control step of every world; those that do not run stay as they are.

        A world that diverges, or loses a contact for good, ends as it was before, not `ok`.

        Returns:
            The states, and MuJoCo Warp's bits of overflow [B] of the worlds that ran.
        """
        run = state.ok & active
        closed = controllers.gripper_command(state.closed, jnp.asarray(command.gripper))
        target = jnp.asarray(command.target, jnp.float32)
        fingers = controllers.finger_targets(closed)
        goal = controllers.goal(self.controller, target, state.rest)
        sense = jax.vmap(functools.partial(self._sense, scratch))
        integrate = jax.vmap(functools.partial(self._integrate, scratch))
        control = jax.vmap(functools.partial(controllers.torque, self.controller))

        def substep(_: int, now: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
            qpos, qvel, warmstart, overflow = now
            arm, begun = sense(bodies, qpos, qvel, warmstart)
            torque = jnp.clip(control(arm, *goal), *self._limits)
            ctrl = jnp.zeros((len(target), self.scene.physics.nu))
            ctrl = ctrl.at[:, self.scene.arm].set(torque).at[:, self.scene.fingers].set(fingers)
            *moved, bits = integrate(bodies, begun, qpos, qvel, warmstart, ctrl)
            return *moved, overflow | bits

        # On CUDA, matrix products are of lower precision unless asked otherwise.
        with jax.default_matmul_precision("highest"):
            nothing = jnp.zeros(len(target), jnp.int32)
            start = (state.qpos, state.qvel, state.warmstart, nothing)
            qpos, qvel, warmstart, overflow = jax.lax.fori_loop(0, self.substeps, substep, start)
            sound = (abs(qpos) < mujoco.mjMAXVAL).all(-1) & (abs(qvel) < mujoco.mjMAXVAL).all(-1)
            sound &= (overflow & LOST_FOR_GOOD) == 0
            moved = run & sound

            def pick(new: jax.Array, old: Array) -> jax.Array:
                return jnp.where(moved.reshape(-1, *[1] * (new.ndim - 1)), new, old)

            qpos = pick(qpos, state.qpos)
            position, rotation = self._grip(scratch, qpos)
        after = State(
            qpos=qpos,
            qvel=pick(qvel, state.qvel),
            warmstart=pick(warmstart, state.warmstart),
            closed=pick(closed, state.closed),
            rest=state.rest,
            grip_position=position,
            grip_rotation=rotation,
            ok=state.ok & (sound | ~run),
        )
        return after, jnp.where(run, overflow, 0)

    def _sense(
        self,
        scratch: Scratch,
        bodies: Bodies,
        qpos: jax.Array,
        qvel: jax.Array,
        warmstart: jax.Array,
    ) -> tuple[ArmState, mjx.Data | None]:
        """What the controller reads of one world; with MJX-JAX, also the physics step begun."""
        begun = None
        if self.impl == "jax":
            model = self.model.tree_replace(bodies)
            data = scratch.full.replace(qpos=qpos, qvel=qvel, qacc_warmstart=warmstart)
            data = begun = mjx.fwd_velocity(model, mjx.fwd_position(model, data))
            mass = data._impl.M[np.ix_(self.scene.arm, self.scene.arm)]
        else:
            # MuJoCo Warp has no half step in MJX: what comes before the contacts is computed twice.
            data = mjx.forward(self._bare, scratch.bare.replace(qpos=qpos, qvel=qvel))
            mass = data._impl.M[self._mass_at]
        arm, site = self.scene.arm, self.scene.grip_site
        origin = data.subtree_com[self._host_model.body_rootid[self._body]]
        spin, slide = jnp.split(data.cdof[arm], 2, -1)
        slide = slide + jnp.cross(spin, data.site_xpos[site] - origin)
        state = ArmState(
            q=qpos[arm],
            qd=qvel[arm],
            position=data.site_xpos[site],
            rotation=data.site_xmat[site],
            jacobian=jnp.concatenate([slide, spin], -1).T,
            mass=mass,
            bias=data.qfrc_bias[arm],
        )
        return state, begun

    def _integrate(
        self,
        scratch: Scratch,
        bodies: Bodies,
        begun: mjx.Data | None,
        qpos: jax.Array,
        qvel: jax.Array,
        warmstart: jax.Array,
        ctrl: jax.Array,
    ) -> tuple[jax.Array, ...]:
        """One physics step of one world: position, velocity, warm start, bits of overflow."""
        model = self.model.tree_replace(bodies)
        if begun is not None:
            data = mjx.fwd_acceleration(model, mjx.fwd_actuation(model, begun.replace(ctrl=ctrl)))
            data = mjx.euler(model, mjx.solve(model, data))
            return data.qpos, data.qvel, data.qacc_warmstart, jnp.int32(0)
        data = scratch.full.replace(qpos=qpos, qvel=qvel, qacc_warmstart=warmstart, ctrl=ctrl)
        data = mjx.step(model, data)
        return data.qpos, data.qvel, data.qacc_warmstart, data._impl.overflow

    def _grip(self, scratch: Scratch, qpos: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Grip sites' positions [B, 3] and axes [B, 3, 3]."""
        bare, site = scratch.bare, self.scene.grip_site

        def one(qpos: jax.Array) -> tuple[jax.Array, jax.Array]:
            data = mjx.kinematics(self._bare, bare.replace(qpos=qpos))
            return data.site_xpos[site], data.site_xmat[site]

        return jax.vmap(one)(qpos)
