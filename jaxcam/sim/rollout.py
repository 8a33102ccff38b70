"""Policy chunks to commands to physics to success, for a batch of episodes.

The policy is asked once per chunk for the whole batch, each episode seen by its own cameras; the
chunk is executed open loop, or averaged with those before it and one step of it executed. Worlds
that are done or have failed stay as they are.
"""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from jaxcam.config.names import RayFrame
from jaxcam.rays.rotations import Array, array_namespace
from jaxcam.sim.actions import (
    action_dim,
    are_numbers,
    averageable,
    averaged,
    decode,
    measured,
)
from jaxcam.sim.engine import Engine, Play, Progress
from jaxcam.sim.ensemble import ensemble
from jaxcam.sim.observing import Cameras, Instant, Told, cameras_of, observe
from jaxcam.sim.painter import Painter
from jaxcam.sim.task import Task
from jaxcam.sim.types import Command, Start, State
from jaxcam.sim.world import World

PolicyCall = Callable[[dict[str, np.ndarray], int, np.ndarray], np.ndarray]
"""`act(obs, call, active)`: observations of all episodes, number of the call, and which episodes go
on [B], to chunks [B, T, A]; those of the others are not looked at. MJX engines want a
`jax.tree_util.Partial`, so that new weights need no new compilation."""


@dataclass(frozen=True)
class Agent:
    """A policy, and how it is asked."""

    act: PolicyCall
    space: str
    """Name of the space of its actions, see `jaxcam.sim.actions`."""
    execute: int | None = None
    """Steps of a chunk that are executed; the whole chunk when None. With ensembling, which needs
    it, the steps that are averaged."""
    obs_steps: int = 1
    """Observations that it sees at once; before the start they are the first one."""
    ensembling: float = 0.0
    """Rate of temporal ensembling, see `jaxcam.sim.ensemble`: the policy is asked at every step; 0
    is off."""
    causes: Mapping[int, str] = field(default_factory=dict[int, str])
    """Why it gave no actions, by number of the episode in the batch, where it can say: filled while
    it is asked."""
    ray_frame: RayFrame = "base"
    """In which frame it is told its cameras."""


@dataclass(frozen=True)
class Episodes:
    """A batch of episodes before they are run."""

    start: Start
    """How they begin, [B, ...]."""
    K: np.ndarray = field(repr=False)
    """Intrinsics of their cameras, in pixels of the painter's pictures [B, V, 3, 3]."""
    world_from_camera: np.ndarray = field(repr=False)
    """Poses of their cameras, OpenCV axes [B, V, 4, 4]."""
    alive: np.ndarray | None = field(default=None, repr=False)
    """[B] False for episodes that only fill the batch up; all are alive when None."""
    lens: np.ndarray | None = field(default=None, repr=False)
    """Packed coefficients of their cameras [B, V, 9]; None where all are pinholes."""
    claimed: Told = field(default_factory=Told, repr=False)
    """What the policy is told of them that is not so."""


@dataclass(frozen=True)
class Rollouts:
    """What happened in a batch of episodes."""

    success: np.ndarray
    """[B] bool: success at any control step."""
    steps: np.ndarray
    """[B] control steps to success, or until the episode was cut."""
    ok: np.ndarray
    """[B] bool: the physics stayed finite."""
    qpos: np.ndarray = field(repr=False)
    """[T + 1, B, nq] the way there, for videos."""
    acted: np.ndarray
    """[B] bool: the policy gave actions at each turn: numbers, of the right shape."""


def rollout(
    agent: Agent,
    task: Task,
    engine: Engine,
    painter: Painter,
    episodes: Episodes,
    tick: Callable[[], None] = lambda: None,
) -> Rollouts:
    """Runs episodes until success or the task's horizon.

    Args:
        agent: Whose actions are executed.
        task: Whose success counts.
        engine: Steps the episodes' world, with the controller of the agent's actions.
        painter: Draws that world, at the policy's resolution.
        episodes: What is run.
        tick: Called after every control step.
    """
    world: World = engine.scene
    turn = _turn(
        painter, agent.space, agent.execute, agent.obs_steps, agent.ensembling, agent.ray_frame
    )
    cameras = cameras_of(
        world, episodes.K, episodes.world_from_camera, episodes.lens, episodes.claimed
    )
    inputs = _Inputs(agent.act, cameras)
    progress, trace = engine.run(
        turn,
        inputs,
        episodes.start,
        task.success_in(world),
        task.horizon,
        episodes.alive,
        tick,
    )
    return Rollouts(
        success=np.asarray(progress.success),
        steps=np.asarray(progress.steps),
        ok=np.asarray(progress.state.ok),
        qpos=np.asarray(trace),
        acted=np.asarray(progress.alive),
    )


class _Inputs(NamedTuple):
    act: PolicyCall
    cameras: Cameras


class _Carried(NamedTuple):
    """What a turn carries on to the next one."""

    anchor: Array
    """The last target, which deltas add to."""
    before: tuple[Instant, ...]
    """The steps before, if the policy sees several."""
    mean: Array
    """What was predicted for the steps to come [B, T, N], if that is averaged."""


class _PolicyTurn:
    """Pictures to a chunk of actions to commands."""

    def __init__(
        self,
        painter: Painter,
        space: str,
        execute: int | None,
        obs_steps: int,
        ensembling: float,
        ray_frame: RayFrame,
    ) -> None:
        self._world, self._painter = painter.scene, painter
        self._space, self._execute, self._past = space, execute, obs_steps - 1
        self._ensembling = ensembling
        self._ray_frame: RayFrame = ray_frame

    def first(self, state: State) -> _Carried:
        before = (Instant.of(state, np.zeros((), int)),) * self._past
        anchor = measured(self._space, state, self._world.arm)
        averaged_steps = (self._execute or 0) if self._ensembling else 0
        still = anchor[:, None].repeat(averaged_steps, 1)
        return _Carried(anchor, before, averageable(self._space, still, still[..., 0]))

    def __call__(
        self,
        play: Play,
        progress: Progress,
        carried: _Carried,
        call: Array,
        start: Start,
        inputs: _Inputs,
    ) -> tuple[Progress, _Carried, Array]:
        xp, active = array_namespace(carried.anchor), progress.active
        observed = [*carried.before, Instant.of(progress.state, progress.taken)]
        steps = [
            observe(self._painter, one, start, inputs.cameras, active, self._ray_frame)
            for one in observed
        ]
        obs = {name: xp.stack([step[name] for step in steps], 1) for name in steps[0]}
        obs = obs if self._past else steps[0]
        chunk = self._chunk(xp.asarray(inputs.act(obs, call, active)), len(active))
        acts = are_numbers(chunk)
        # A world that is done sees black: its chunk is not used.
        progress = progress._replace(alive=progress.alive & (acts | ~active))
        chunk = xp.where(acts[:, None, None], chunk, 0)
        targets, gripper = decode(self._space, chunk, carried.anchor, self._world.nominal_grip)
        mean = carried.mean
        if self._ensembling:
            numbers = averageable(self._space, targets, gripper)
            now, mean = ensemble(mean, numbers, call, self._ensembling)
            targets, gripper = averaged(self._space, now[:, None])
        way, begin, length = [], 0, targets.shape[1]
        # Stops at the steps that the next turn looks back at.
        for end in range(max(1, length - self._past), length + 1):
            command = Command(targets[:, begin:end], gripper[:, begin:end])
            progress, part = play(progress, command)
            way.append(part)
            begin = end
            if end < length:
                observed.append(Instant.of(progress.state, progress.taken))
        before = tuple(observed[len(observed) - self._past :])
        return progress, _Carried(targets[:, -1], before, mean), xp.concatenate(way)

    def _chunk(self, chunk: Array, count: int) -> Array:
        """The steps that are executed [B, T, A]; no numbers where a policy gave another shape."""
        steps, size = self._execute or 1, action_dim(self._space)
        least = steps if self._ensembling else 1  # what is averaged has one length
        if chunk.ndim == 3 and chunk.shape[::2] == (count, size) and chunk.shape[1] >= least:
            return chunk[:, : self._execute]
        return array_namespace(chunk).full((count, steps, size), np.nan)


# One turn for the same arguments: it is what a compiled program is known by.
_turn = functools.lru_cache(8)(_PolicyTurn)
