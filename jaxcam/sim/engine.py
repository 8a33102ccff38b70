"""What a physics engine promises: batches of states in, batches of states out.

An engine knows the scene and a controller but no task. It advances worlds by control steps; a world
whose physics diverges is flagged and left, the others go on.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from jaxcam.rays.rotations import Array, array_namespace
from jaxcam.sim.types import Command, Start, State, Success


class Progress(NamedTuple):
    """A batch of episodes on its way. Those that are done, lost or out of time stay as they are."""

    state: State
    alive: Array
    """[B] False where an episode was given up for what is not physics."""
    success: Array
    """[B] success at any control step so far."""
    steps: Array
    """[B] control steps to success; the horizon without."""
    taken: Array
    """Control steps so far, of all episodes; or of each [B], where they began one by one."""
    horizon: Array
    """Control steps after which an episode is out of time."""

    @property
    def active(self) -> Array:
        """[B] episodes that go on."""
        return ~self.success & self.state.ok & self.alive & (self.taken < self.horizon)


def begin(state: State, horizon: int, alive: Array | None = None) -> Progress:
    """The progress of episodes that start in `state`, of which those not `alive` stay there."""
    count = len(state.ok)
    return Progress(
        state=state,
        alive=np.ones(count, bool) if alive is None else alive,
        success=np.zeros(count, bool),
        steps=np.full(count, horizon),
        taken=np.zeros((), int),
        horizon=np.array(horizon),
    )


def control_step(
    step: Callable[[State, Command, Array], State],
    is_done: Callable[[State], Array],
    progress: Progress,
    command: Command,
) -> Progress:
    """One control step of the episodes that go on; under NumPy and under `jax.jit`.

    Args:
        step: An engine's.
        is_done: Success of each world.
        progress: So far.
        command: Targets [B, ...].
    """
    active = progress.active
    state = step(progress.state, command, active)
    now = active & state.ok & is_done(state)
    taken = progress.taken + 1
    steps = array_namespace(now).where(now, taken, progress.steps)
    success = progress.success | now
    return progress._replace(state=state, success=success, steps=steps, taken=taken)


Play = Callable[[Progress, Command], tuple[Progress, Array]]
"""Executes commands [B, T, ...] open loop: progress after them, and the way there [T, B, nq]."""


class Turn(Protocol):
    """What happens between an episode's states: look, decide, play. A pure function of arrays."""

    def first(self, state: State) -> Array:
        """What it carries from one turn to the next, at the start of episodes."""
        ...

    def __call__(
        self, play: Play, progress: Progress, carried: Array, call: Array, start: Start, inputs: Any
    ) -> tuple[Progress, Array, Array]:
        """Plays commands of its choice: progress, what is carried on, the way there [T, B, nq].

        Args:
            play: Executes commands.
            progress: Of the episodes.
            carried: What the last turn returned.
            call: Number of the turn, from 0.
            start: How the episodes began.
            inputs: What `Engine.run` was given.
        """
        ...


class OpenLoop:
    """A turn that plays the commands [B, horizon, ...] it is given as inputs."""

    def first(self, state: State) -> Array:
        """Nothing is carried on."""
        return state.closed

    def __call__(
        self,
        play: Play,
        progress: Progress,
        carried: Array,
        call: Array,
        start: Start,
        inputs: Command,
    ) -> tuple[Progress, Array, Array]:
        """Plays them."""
        progress, way = play(progress, inputs)
        return progress, carried, way


class Engine(Protocol):
    """Steps a batch of worlds of one scene with one controller."""

    scene: Any
    """The world (`jaxcam.sim.world.World`) whose states it advances."""
    substeps: int
    """Physics steps per control step."""

    def reset(self, start: Start) -> State:
        """Puts a batch of worlds at their starts, at rest, gripper half open."""
        ...

    def restart(self, state: State, start: Start, again: np.ndarray) -> State:
        """Puts some worlds of a batch at a start, as `reset` would; the others stay as they are.

        Args:
            state: Of the batch.
            start: Of all its episodes: those that go on and those that begin.
            again: [B] bool, worlds whose episodes begin.
        """
        fresh = self.reset(start)
        xp = array_namespace(state.qpos)
        return State(*(
            xp.where(again.reshape(-1, *[1] * (old.ndim - 1)), new, old)
            for old, new in zip(state, fresh, strict=True)
        ))  # fmt: skip

    def step(self, state: State, command: Command, active: Array | None = None) -> State:
        """Advances the worlds one control step; those not `active` [B] stay as they are."""
        ...

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
        """Runs episodes, turn by turn, until each succeeds, is lost or runs out of time.

        Args:
            turn: Chooses commands.
            inputs: Arrays for it.
            start: Of the episodes.
            success: The task's, in this world.
            horizon: Control steps after which episodes are out of time.
            alive: [B] False for episodes that only fill the batch up; all when None.
            tick: Called once for every control step.

        Returns:
            The progress at the end, and the way there [T + 1, B, nq].
        """
        state = self.reset(start)
        progress, carried, call = begin(state, horizon, alive), turn.first(state), 0
        trace = [state.qpos[None]]

        def play(progress: Progress, commands: Command) -> tuple[Progress, Array]:
            way = []
            for t in range(min(commands.target.shape[1], horizon - int(progress.taken))):
                command = Command(commands.target[:, t], commands.gripper[:, t])
                progress = control_step(
                    self.step, lambda state: success(state, start), progress, command
                )
                way.append(progress.state.qpos)
                tick()
            return progress, np.reshape(way, (-1, *progress.state.qpos.shape))

        while progress.active.any():
            progress, carried, way = turn(play, progress, carried, np.array(call), start, inputs)
            trace.append(way)
            call += 1
        return progress, np.concatenate(trace)
