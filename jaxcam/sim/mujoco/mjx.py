"""Physics by MJX: a batch of worlds advances in one compiled program, on a GPU or on the CPU.

`impl="warp"` runs MuJoCo Warp's kernels and takes every kind of geom; `impl="jax"` is pure XLA, so
it also runs where Warp does not (TPU), but it refuses some pairs of geoms. Both compute in float32.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxcam.rays.rotations import Array
from jaxcam.sim.engine import Engine, Progress, Turn, begin, control_step
from jaxcam.sim.mujoco.mjx_model import Bodies
from jaxcam.sim.mujoco.mjx_physics import Impl, MjxPhysics
from jaxcam.sim.mujoco.mjx_room import Room
from jaxcam.sim.mujoco.scene import Scene
from jaxcam.sim.types import Command, ControllerName, Start, State, Success


@functools.cache
def _compile_options() -> dict[str, bool] | None:
    """Without XLA's fusion emitters on a CPU, where they can be left out: until JAX 0.12.

    They take six times as long over MJX-JAX's long chains of small operations.
    """
    options = {"xla_cpu_use_fusion_emitters": False}
    if jax.default_backend() != "cpu":
        return None
    try:
        jax.jit(lambda x: x, compiler_options=options).lower(0.0).compile()
    except jax.errors.JaxRuntimeError:  # no such option
        return None
    return options


class MjxEngine(Engine):
    """Steps worlds with MJX, the controller in the same program; see `Engine`.

    Nothing here leaves the device. A world's step depends on its `State` alone: contacts and other
    scratch are made anew in every physics step.

    Args:
        scene: Whose physics model is stepped.
        controller: `osc_pose` or `joint_position`.
        varied: Geoms whose sizes differ between episodes (`Start.geom_size`); each must be the only
            geom with mass of its free body, which must be a box of uniform density.
        impl: `warp` or `jax`.
        room: Room for contacts (`warp`); when None, two contacts for each pair of geoms that may
            meet, at most 44, and four constraint rows for each contact. Where it does not suffice,
            it is doubled, and what was computed is computed again.

    Raises:
        ConfigError: If MJX-JAX cannot collide two of the scene's geoms.
    """

    def __init__(
        self,
        scene: Scene,
        controller: ControllerName = "osc_pose",
        varied: Sequence[str] = (),
        impl: Impl = "warp",
        *,
        room: Room | None = None,
    ) -> None:
        self.scene = scene
        self.controller: ControllerName = controller
        self.physics = MjxPhysics(scene, controller, varied, impl)
        self.substeps = self.physics.substeps
        self.room = room or Room(self.physics.usual_contacts)
        self._make_programs()

    def _make_programs(self) -> None:
        """Makes the programs, for the room there is."""
        contacts, rows = self.room.contacts, self.room.rows
        self._scratch = functools.cache(
            lambda count: self.physics.scratch(count, contacts=contacts, rows=rows)
        )
        jit = functools.partial(jax.jit, compiler_options=_compile_options())
        # Functions of their own: those of other rooms are known by theirs.
        self._jit_begin = jit(lambda start: self._begin(start))
        self._jit_advance = jit(lambda *now: self._advance(*now))
        self._jit_run = jit(lambda *all: self._run(*all), static_argnums=(0, 1, 2))

    def reset(self, start: Start) -> State:
        """Puts a batch of worlds at their starts; see `Engine.reset`."""
        state, self._bodies = self._jit_begin(start)
        return state

    def step(self, state: State, command: Command, active: Array | None = None) -> State:
        """Advances the worlds one control step; see `Engine.step`.

        Raises:
            SimError: If contacts were lost for want of room, however much there was.
        """
        run = jnp.ones(len(state.ok), bool) if active is None else active
        return self._with_room(lambda: self._jit_advance(self._bodies, state, command, run))

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
            SimError: If contacts were lost for want of room, however much there was.
        """
        self._tick, self._ticks_left = tick, horizon
        progress, trace = self._with_room(
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
        state, bodies = self._begin(start)
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

    def _begin(self, start: Start) -> tuple[State, Bodies]:
        state = self.physics.begin(self._scratch(len(start.qpos)), start)
        return state, self.physics.bodies(start)

    def _advance(self, bodies: Bodies, state: State, command: Command, active: Array) -> State:
        scratch = self._scratch(len(state.ok))
        after, overflow = self.physics.advance(scratch, bodies, state, command, active)
        if self.physics.impl == "warp":
            self.room.report(overflow)
        return after

    def _with_room(self, compute: Callable[[], Any]) -> Any:
        return self.room.make_sure(self.scene.name, compute, self._make_programs)
