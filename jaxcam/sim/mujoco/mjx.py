"""Physics by MJX: a batch of worlds advances in one compiled program, on a GPU or on the CPU.

`impl="warp"` runs MuJoCo Warp's kernels and takes every kind of geom; `impl="jax"` is pure XLA, so
it also runs where Warp does not (TPU), but it refuses some pairs of geoms. Both compute in float32.
"""

import functools
import logging
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from jaxcam.errors import SimError
from jaxcam.rays.rotations import Array
from jaxcam.sim import controllers
from jaxcam.sim.controllers import ArmState
from jaxcam.sim.engine import Engine, Progress, Turn, begin, control_step
from jaxcam.sim.mujoco.bodies import full_from_sparse
from jaxcam.sim.mujoco.mjx_model import (
    Bodies,
    bare,
    check_pairs,
    filtered,
    pair_count,
    resized,
    suit_warp,
)
from jaxcam.sim.mujoco.scene import Scene
from jaxcam.sim.types import Command, ControllerName, Start, State, Success

Impl = Literal["jax", "warp"]
T = TypeVar("T")

_LOG = logging.getLogger(__name__)
_MOST = {"contacts": 512, "rows": 2048}
"""Room a world that no sound scene needs."""
_OVERFLOWS = {
    1 << 0: "rows",  # more constraint rows in a world than njmax
    1 << 1: "rows",  # njmax_nnz, which follows from njmax
    1 << 2: "contacts",  # more pairs near each other than naconmax
    1 << 3: "contacts",  # more contacts than naconmax
    1 << 4: "contacts",  # naccdmax, which follows from naconmax
}
"""Bits of MuJoCo Warp's `overflow` that mean lost contacts, and the argument to raise. The others
tell of what this project does not use, or of a solver that stopped at its limit of iterations,
which MuJoCo's C library does in silence too."""

_CPU_OPTIONS = {"xla_cpu_use_fusion_emitters": False}
"""XLA's fusion emitters take six times as long over MJX-JAX's long chains of small operations."""


class MjxEngine(Engine):
    """Steps worlds with MJX, the controller in the same program; see `Engine`.

    Nothing here leaves the device. A world's step depends on its `State` alone: contacts and other
    scratch are made anew in every physics step.

    Args:
        scene: whose physics model is stepped.
        controller: `osc_pose` or `joint_position`.
        varied: geoms whose sizes differ between episodes (`Start.geom_size`); each must be the only
            geom with mass of its free body, which must be a box of uniform density.
        impl: `warp` or `jax`.
        contacts: room for contacts, per world on average over the batch (`warp`); when None, two
            for each pair of geoms that may meet, at most 44.
        rows: room for constraint rows in each world (`warp`); when None, four for each contact.
            Where either does not suffice, it is doubled, and what was computed is computed again.

    Raises:
        ConfigError: if MJX-JAX cannot collide two of the scene's geoms.
    """

    def __init__(
        self,
        scene: Scene,
        controller: ControllerName = "osc_pose",
        varied: Sequence[str] = (),
        impl: Impl = "warp",
        *,
        contacts: int | None = None,
        rows: int | None = None,
    ) -> None:
        self.scene, self.impl = scene, impl
        self.controller: ControllerName = controller
        self.substeps = round(1 / controllers.CONTROL_HZ / scene.physics.opt.timestep)
        self._varied = [scene.physics.geom(name).id for name in varied]
        self._limits = scene.physics.actuator_ctrlrange[scene.arm].T.astype(np.float32)
        model = filtered(scene.physics)
        if impl == "jax":
            check_pairs(model)
        else:
            suit_warp(model)
        # Time goes with the room. The most that demonstrations need is 40 (Square).
        room = contacts or min(44, 2 * pair_count(model) + 2)
        self._room = {"contacts": room, "rows": rows or 4 * room}
        self._host_model = model
        self._body = int(model.site_bodyid[scene.grip_site])
        self._here = jax.local_devices()[0]  # MJX would take the first of all processes' devices
        put = functools.partial(mjx.put_model, device=self._here, impl=impl)
        self._model = put(model)
        if impl == "warp":  # overflows are read from the data; a print from a kernel is no error
            self._model = self._model.tree_replace({"opt._impl.warn_overflow": 0})
        self._bare = self._model if impl == "jax" else put(bare(model))
        self._mass_at = full_from_sparse(model)[np.ix_(scene.arm, scene.arm)]
        self._overflow = 0
        self._jit()

    def _jit(self) -> None:
        """Makes the programs, for the room there is."""
        self._scratch = functools.cache(self._make_scratch)
        on_cpu = jax.default_backend() == "cpu"
        jit = functools.partial(jax.jit, compiler_options=_CPU_OPTIONS if on_cpu else None)
        # Functions of their own: those of other rooms are known by theirs.
        self._jit_begin = jit(lambda start: (self._state(start), self._bodies(start)))
        self._jit_advance = jit(lambda *now: self._advance(*now))
        self._jit_run = jit(lambda *all: self._run(*all), static_argnums=(0, 1, 2))

    def reset(self, start: Start) -> State:
        """Puts a batch of worlds at their starts; see `Engine.reset`."""
        state, self._now = self._jit_begin(start)
        return state

    def step(self, state: State, command: Command, active: Array | None = None) -> State:
        """Advances the worlds one control step; see `Engine.step`.

        Raises:
            SimError: if contacts were lost for want of room, however much there was.
        """
        run = jnp.ones(len(state.ok), bool) if active is None else active
        return self._roomy(lambda: self._jit_advance(self._now, state, command, run))

    def run(
        self,
        turn: Turn,
        inputs: Any,
        start: Start,
        success: Success,
        horizon: int,
        alive: Array | None = None,
        tick: Callable[[], None] = lambda: None,
    ) -> tuple[Progress, Array]:
        """Runs whole episodes in one compiled program; see `Engine.run`.

        It is compiled once for a `turn`, a `success` and the arrays' shapes.

        Raises:
            SimError: if contacts were lost for want of room, however much there was.
        """
        self._tick, self._ticks_left = tick, horizon
        progress, trace = self._roomy(
            lambda: self._jit_run(turn, success, horizon, inputs, start, alive)
        )
        return progress, trace[: min(int(progress.taken), horizon) + 1]

    def lower(
        self, turn: Turn, inputs: Any, start: Start, success: Success, horizon: int
    ) -> jax.stages.Lowered:
        """The program of `run`, from shapes alone."""
        return self._jit_run.lower(turn, success, horizon, inputs, start, None)

    def _run(
        self,
        turn: Turn,
        success: Success,
        horizon: int,
        inputs: Any,
        start: Start,
        alive: Array | None,
    ) -> tuple[Progress, jax.Array]:
        state, bodies = self._state(start), self._bodies(start)
        progress = jax.tree.map(jnp.asarray, begin(state, horizon, alive))
        play = functools.partial(self._play, success, bodies, start)

        def one(now: tuple[Any, ...]) -> tuple[Any, ...]:
            progress, carried, call, trace = now
            so_far = progress.taken
            progress, carried, way = turn(play, progress, carried, call, start, inputs)
            jax.debug.callback(self._count, jnp.minimum(progress.taken, horizon) - so_far)
            trace = jax.lax.dynamic_update_slice_in_dim(trace, way, so_far + 1, 0)
            return progress, carried, call + 1, trace

        first = (progress, turn.first(state), jnp.int32(0))
        _, _, way = jax.eval_shape(functools.partial(turn, play), *first, start, inputs)
        # The last turn may reach beyond the horizon, where nothing moves.
        room = jnp.zeros((horizon + len(way), *way.shape[1:]), way.dtype)
        trace = jnp.concatenate([state.qpos[None], room])
        now = jax.lax.while_loop(lambda now: now[0].active.any(), one, (*first, trace))
        return now[0], now[-1]

    def _play(
        self, success: Success, bodies: Bodies, start: Start, progress: Progress, commands: Command
    ) -> tuple[Progress, jax.Array]:
        step = functools.partial(self._advance, bodies)

        def one(progress: Progress, command: Command) -> tuple[Progress, jax.Array]:
            progress = control_step(step, lambda state: success(state, start), progress, command)
            return progress, progress.state.qpos

        in_time = Command(*(jnp.moveaxis(x, 1, 0) for x in commands))
        return jax.lax.scan(one, progress, in_time)

    def _count(self, steps: np.ndarray) -> None:
        # What is computed again has been counted.
        for _ in range(min(int(steps), self._ticks_left)):
            self._tick()
        self._ticks_left -= min(int(steps), self._ticks_left)

    def _roomy(self, compute: Callable[[], T]) -> T:
        """What `compute` gives, once no contacts are lost for want of room."""
        while True:
            result = jax.block_until_ready(compute())
            jax.effects_barrier()
            bits, self._overflow = self._overflow, 0
            short = {name for bit, name in _OVERFLOWS.items() if bits & bit}
            if not short:
                return result
            for name in sorted(short):
                self._double(name)
            self._jit()

    def _double(self, name: str) -> None:
        """Doubles the room for `name`, `contacts` or `rows`."""
        told = f"MJX-Warp had room for {self._room[name]} {name} a world, and lost contacts."
        self._room[name] *= 2
        if self._room[name] > _MOST[name]:
            raise SimError(
                f"{told} The scene {self.scene.name!r} needs more than {_MOST[name]}: look at the "
                "physics, or choose --engine native."
            )
        _LOG.warning("%s It goes on with %d, from where that was.", told, self._room[name])

    def _state(self, start: Start) -> State:
        qpos = jnp.asarray(start.qpos, jnp.float32)
        count, still = len(qpos), jnp.zeros((len(qpos), self.scene.physics.nv))
        position, rotation = self._grip(qpos)
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

    def _bodies(self, start: Start) -> Bodies:
        fields = resized(self._host_model, self._varied, start.geom_size)
        return {n: x.reshape(-1, *getattr(self._model, n).shape) for n, x in fields.items()}

    def _advance(self, bodies: Bodies, state: State, command: Command, active: Array) -> State:
        """One control step of every world; those that do not run stay as they are."""
        run = state.ok & active
        closed = controllers.gripper_command(state.closed, jnp.asarray(command.gripper))
        target = jnp.asarray(command.target, jnp.float32)
        fingers = controllers.finger_targets(closed)
        goal = controllers.goal(self.controller, target, state.rest)
        scratch = self._scratch(len(target))
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
            moved = run & sound

            def pick(new: jax.Array, old: Array) -> jax.Array:
                return jnp.where(moved.reshape(-1, *[1] * (new.ndim - 1)), new, old)

            qpos = pick(qpos, state.qpos)
            position, rotation = self._grip(qpos)
        if self.impl == "warp":
            self._report(jnp.where(run, overflow, 0))
        return State(
            qpos=qpos,
            qvel=pick(qvel, state.qvel),
            warmstart=pick(warmstart, state.warmstart),
            closed=pick(closed, state.closed),
            rest=state.rest,
            grip_position=position,
            grip_rotation=rotation,
            ok=state.ok & (sound | ~run),
        )

    def _sense(
        self,
        scratch: "_Scratch",
        bodies: Bodies,
        qpos: jax.Array,
        qvel: jax.Array,
        warmstart: jax.Array,
    ) -> tuple[ArmState, mjx.Data | None]:
        """What the controller reads of one world; with MJX-JAX, also the physics step begun."""
        begun = None
        if self.impl == "jax":
            model = self._model.tree_replace(bodies)
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
        scratch: "_Scratch",
        bodies: Bodies,
        begun: mjx.Data | None,
        qpos: jax.Array,
        qvel: jax.Array,
        warmstart: jax.Array,
        ctrl: jax.Array,
    ) -> tuple[jax.Array, ...]:
        """One physics step of one world: position, velocity, warm start, bits of overflow."""
        model = self._model.tree_replace(bodies)
        if begun is not None:
            data = mjx.fwd_acceleration(model, mjx.fwd_actuation(model, begun.replace(ctrl=ctrl)))
            data = mjx.euler(model, mjx.solve(model, data))
            return data.qpos, data.qvel, data.qacc_warmstart, jnp.int32(0)
        data = scratch.full.replace(qpos=qpos, qvel=qvel, qacc_warmstart=warmstart, ctrl=ctrl)
        data = mjx.step(model, data)
        return data.qpos, data.qvel, data.qacc_warmstart, data._impl.overflow

    def _make_scratch(self, count: int) -> "_Scratch":
        with jax.ensure_compile_time_eval():
            make = functools.partial(mjx.make_data, self._host_model, self._here, impl=self.impl)
            if self.impl == "jax":
                return _Scratch(*[make()] * 2)
            full = make(naconmax=self._room["contacts"] * count, njmax=self._room["rows"])
            return _Scratch(full, make(naconmax=1, njmax=1))

    def _report(self, overflow: jax.Array) -> None:
        """Tells the host of lost contacts, for `_roomy`."""
        bits = jax.lax.reduce(overflow & sum(_OVERFLOWS), 0, jax.lax.bitwise_or, (0,))
        told = functools.partial(jax.debug.callback, self._remember)
        jax.lax.cond(bits != 0, told, lambda _: None, bits)

    def _remember(self, bits: np.ndarray) -> None:
        self._overflow |= int(bits)

    def _grip(self, qpos: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Grip sites' positions [B, 3] and axes [B, 3, 3]."""
        bare, site = self._scratch(len(qpos)).bare, self.scene.grip_site

        def one(qpos: jax.Array) -> tuple[jax.Array, jax.Array]:
            data = mjx.kinematics(self._bare, bare.replace(qpos=qpos))
            return data.site_xpos[site], data.site_xmat[site]

        return jax.vmap(one)(qpos)


class _Scratch(NamedTuple):
    """Data that every physics step of a batch starts from."""

    full: mjx.Data
    bare: mjx.Data
    """With no room for contacts."""
