"""The worlds of a batch of environments: each episode begins and ends on its own.

They are stepped and drawn by what rollouts are stepped and drawn by (`jaxcam.sim.rollout`), and by
the same rules: an action that is no number ends its episode as the policy's failure, physics that
diverges ends it without an outcome, and episodes that are over stay as they are.
"""

import functools
from typing import NamedTuple

import numpy as np

from jaxcam.config.sizes import rows_and_columns
from jaxcam.envs.episodes import Begun
from jaxcam.envs.options import EnvOptions
from jaxcam.envs.shaped import ShapedReward
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.sim import engine_name, make_engine, make_painter, make_task
from jaxcam.sim.actions import are_numbers, controller_of, decode, measured, space_of
from jaxcam.sim.engine import Progress, begin, control_step
from jaxcam.sim.observing import Cameras, Instant, cameras_of, observe
from jaxcam.sim.painter import Painter
from jaxcam.sim.types import Command, Start, State, View
from jaxcam.sim.world import World

MOST_AT_ONCE = 32
"""Pictures that are drawn at once."""


class Endings(NamedTuple):
    """How the episodes of a batch stand [B]."""

    success: np.ndarray
    """Whether the task is done."""
    failed: np.ndarray
    """Whether the policy gave an action that is no number."""
    broken: np.ndarray
    """Whether the physics has diverged."""
    late: np.ndarray
    """Whether the time is over, without success."""
    steps: np.ndarray
    """Control steps so far."""

    @property
    def over(self) -> np.ndarray:
        """Which episodes have ended."""
        return self.success | self.failed | self.broken | self.late


class _Now(NamedTuple):
    """The episodes, [B] all."""

    start: Start
    cameras: Cameras
    progress: Progress
    anchor: np.ndarray
    """The last targets, which deltas add to."""


class Batch:
    """A batch of worlds of one task, and the episodes in them.

    Args:
        options: What they are.
        count: How many.

    Raises:
        ConfigError: There is no such world, or the engine cannot step it.
        SimError: This machine lacks what the task needs.
    """

    def __init__(self, options: EnvOptions, count: int) -> None:
        self.options, self.count = options, count
        self.views, self.horizon = options.views or 1, options.horizon or 1
        self.task = make_task(options.task)
        self.task.require()
        self.world: World = self.task.scene(options.scene)
        self.space = space_of(options.action_space, options.rotations)
        self.engine = make_engine(
            engine_name(options.engine, self.world),
            self.world,
            controller_of(self.space),
            self.task.varied,
        )
        self.painter = self._painter(options.resolution, self.views)
        self.K = intrinsics(self.task.fovy_deg, self.painter.height, self.painter.width)
        self._large: Painter | None = None
        self._is_done = self.task.success_in(self.world)
        shaped = options.reward == "shaped"
        self._shaped = ShapedReward(options.task, self.world) if shaped else None
        self._now: _Now | None = None
        self._shown: dict[str, np.ndarray] = {}
        self._qpos = np.zeros((count, self.world.nq))

    @property
    def now(self) -> _Now:
        """The episodes, once they have begun."""
        assert self._now is not None
        return self._now

    def begin(self, again: np.ndarray, begun: Begun) -> None:
        """Begins episodes, and looks at them.

        Args:
            again: [B] bool, in which worlds; in all of them the first time.
            begun: The episodes, one for each of those worlds.
        """
        K = np.tile(self.K, (len(begun.cameras), self.views, 1, 1))
        cameras = cameras_of(self.world, K, begun.cameras)
        if self._now is None:
            start, state = begun.start, self.engine.reset(begun.start)
            progress = _each_on_its_own(begin(state, self.horizon))
        else:
            old = self._now
            start = Start(*_replaced(old.start, again, begun.start))
            poses = _replaced(old.cameras[:3], again, cameras[:3])
            cameras = Cameras(poses[0], poses[1], poses[2])
            state = self.engine.restart(old.progress.state, start, again)
            fresh = _each_on_its_own(begin(state, self.horizon))
            progress = fresh._replace(
                **{
                    name: np.where(again, getattr(fresh, name), getattr(old.progress, name))
                    for name in ("alive", "success", "steps", "taken")
                }
            )
        anchor = measured(self.space, state, self.world.arm)
        if self._now is not None:
            anchor = np.where(again[:, None], anchor, self._now.anchor)
        self._now = _Now(start, cameras, progress, anchor)
        self._look(again)

    def play(self, actions: np.ndarray) -> np.ndarray:
        """Executes chunks of actions [B, T, A] open loop, and looks.

        Returns:
            Rewards [B], summed over the control steps of episodes that were not over.
        """
        now = self.now
        progress, active = now.progress, np.asarray(now.progress.active)
        acts = are_numbers(actions)
        progress = progress._replace(alive=progress.alive & (acts | ~active))
        actions = np.where(acts[:, None, None], actions, 0)
        targets, gripper = decode(self.space, actions, now.anchor, self.world.nominal_grip)
        rewards = np.zeros(self.count)
        for t in range(actions.shape[1]):
            going = np.asarray(progress.active)
            if not going.any():
                break
            progress = control_step(
                self.engine.step,
                lambda state: self._is_done(state, now.start),
                progress,
                Command(targets[:, t], gripper[:, t]),
            )
            # Those that are over stay at the step at which they ended.
            taken = np.where(going, progress.taken, progress.taken - 1)
            progress = progress._replace(taken=taken)
            rewards += self._rewards(progress, going & np.asarray(progress.state.ok))
        anchor = np.where((active & acts)[:, None], targets[:, -1], now.anchor)
        self._now = now._replace(progress=progress, anchor=anchor)
        self._look(active & acts & np.asarray(progress.state.ok))
        return rewards

    def outcome(self) -> Endings:
        """How the episodes stand."""
        progress = self.now.progress
        success, taken = np.asarray(progress.success), np.asarray(progress.taken)
        failed, broken = ~np.asarray(progress.alive), ~np.asarray(progress.state.ok)
        late = (taken >= self.horizon) & ~(success | failed | broken)
        return Endings(success, failed, broken, late, taken)

    def observations(self) -> dict[str, np.ndarray]:
        """What was seen last of each episode, in arrays of their own."""
        return {name: array.copy() for name, array in self._shown.items()}

    def pictures(self) -> np.ndarray:
        """Pictures for people, of the first camera, uint8 [B, H, W, 3]."""
        if self._large is None:
            self._large = self._painter(self.options.render_size, 1)
        draw, now = self._large, self.now
        K = intrinsics(self.task.fovy_deg, draw.height, draw.width)
        return draw.rgb(
            View(
                qpos=self._qpos,
                geom_size=now.start.geom_size,
                fixtures=now.start.fixtures,
                K=np.tile(K, (self.count, 1, 1)),
                world_from_camera=now.cameras.world_from_camera[:, 0],
            )
        )

    def _painter(self, size: int | str, views: int) -> Painter:
        """A painter that is asked for so many views of each world, in rounds of one size."""
        pictures = self.count * views
        at_once = -(-pictures // -(-pictures // MOST_AT_ONCE))
        return _painter_of(self.world, *rows_and_columns(size), self.task.varied, at_once)

    def _rewards(self, progress: Progress, going: np.ndarray) -> np.ndarray:
        """Rewards [B] of a control step for the episodes that made it."""
        success = np.asarray(progress.success)
        if self._shaped is None:
            return (going & success).astype(float)
        state = State(*(np.asarray(x) for x in progress.state))
        return self._shaped(state, self.now.start, success, going)

    def _look(self, rows: np.ndarray) -> None:
        """Takes in what is seen of some worlds [B] now; what was seen of the others stays."""
        if not rows.any():
            return
        now, state = self.now, self.now.progress.state
        sensed = Instant._make(np.asarray(x, float) for x in Instant.of(state, now.progress.taken))
        shown = observe(self.painter, sensed, now.start, now.cameras, rows)
        shown["state"] = shown.pop("proprio")
        for name, new in shown.items():
            old = self._shown.setdefault(name, np.zeros_like(new))
            old[rows] = new[rows]
        self._qpos[rows] = sensed.qpos[rows]


@functools.lru_cache(8)
def _painter_of(
    world: World, height: int, width: int, varied: tuple[str, ...], batch: int
) -> Painter:
    """A painter for all environments that want the same: to make one takes a second or two."""
    return make_painter(world, height, width, varied=varied, batch=batch)


def _each_on_its_own(progress: Progress) -> Progress:
    return progress._replace(taken=np.zeros(len(progress.success), int))


def _replaced(
    old: tuple[np.ndarray, ...], rows: np.ndarray, new: tuple[np.ndarray, ...]
) -> list[np.ndarray]:
    """Arrays [B, ...] with those of some rows [n, ...] put in."""
    both = []
    for before, now in zip(old, new, strict=True):
        after = np.array(before)
        after[rows] = now
        both.append(after)
    return both
