"""Many environments as one: a batch of worlds behind Gymnasium's `VectorEnv`."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.utils import EzPickle, seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from jaxcam.envs import spaces
from jaxcam.envs.batch import Batch
from jaxcam.envs.episodes import FRESH, Begun, ResetOptions, fresh, of_pairs, whole_number
from jaxcam.envs.options import EnvOptions
from jaxcam.errors import ConfigError, closest
from jaxcam.sim.controllers import CONTROL_HZ

METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": CONTROL_HZ}
"""What both kinds of environment say of themselves; each adds its `instruction`."""
MOST_ENVS = 100_000


class TaskVectorEnv(VectorEnv[dict[str, np.ndarray], np.ndarray, np.ndarray], EzPickle):
    """Environments of one task, stepped and drawn together; see docs/gymnasium.md.

    A copy, or what was pickled, is another batch with the same options.

    Args:
        num_envs: How many.
        render_mode: `rgb_array`, or None.
        autoreset_mode: What becomes of an episode that is over: the next one begins with the next
            step (`NextStep`), with the same one (`SameStep`), or it stays as it is until `reset`
            with a `reset_mask` (`Disabled`), as rollouts of an evaluation do.
        **options: See `EnvOptions`.

    Raises:
        ConfigError: There is no such option, or no such value of it.
        SimError: This machine lacks what the task needs.
    """

    metadata: dict[str, Any] = {**METADATA, "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **options: Any,
    ) -> None:
        EzPickle.__init__(self, num_envs, render_mode, autoreset_mode, **options)
        if type(num_envs) is not int or not 1 <= num_envs <= MOST_ENVS:
            raise ConfigError(f"num_envs must be 1 to {MOST_ENVS}, got {num_envs!r:.80}.")
        if render_mode not in (None, "rgb_array"):
            raise ConfigError(f"Unknown render_mode {render_mode!r:.80}: rgb_array, or None.")
        self.num_envs, self.render_mode = num_envs, render_mode
        self.options = EnvOptions.of(options)
        self._mode = _autoreset(autoreset_mode)
        self.batch = batch = Batch(self.options, num_envs)
        painter = batch.painter
        self.single_observation_space = spaces.observations(
            batch.K, batch.views, painter.height, painter.width
        )
        self.single_action_space = spaces.actions(batch.space, batch.world, self.options.chunk)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.metadata = {
            **METADATA, "autoreset_mode": self._mode, "instruction": batch.task.prompt
        }  # fmt: skip
        self.rngs: list[np.random.Generator | None] = [None] * num_envs
        self._over: np.ndarray | None = None
        self._pair = np.full(num_envs, FRESH)
        self._seed = np.zeros(num_envs, int)
        self._split = np.full(num_envs, "train", object)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begins episodes.

        Without options those are fresh ones, drawn from each environment's own random numbers,
        which never are a held-out pair's.

        Args:
            seed: Of the random numbers: that of the first environment, of the next one more, and so
                on; or a list of all. They go on as they are when None.
            options: `pair` (its number, or the first environment's, or a list of all), `split` of
                the pairs (`test`, or `validation`), and `reset_mask`, bool [num_envs], for those
                that begin alone.

        Raises:
            ConfigError: There is no such seed, option or pair.
        """
        self._require_open()
        asked = ResetOptions.of(options, self.num_envs)
        if self._over is None and not asked.again.all():
            raise ConfigError("reset: all environments must begin before some begin again.")
        self._seed_with(seed, asked.again)
        batch, again = self.batch, np.flatnonzero(asked.again)
        if asked.pairs is None:
            self._begin_fresh(again)
        else:
            begun = of_pairs(batch.task, batch.world, batch.views, asked.split, asked.pairs)
            self._begin(again, begun)
        return batch.observations(), self._infos(again)

    def step(
        self, actions: np.ndarray
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Executes an action, or a chunk of them, in each environment.

        Args:
            actions: Array [num_envs, A] or, with the option `chunk`, [num_envs, chunk, A].

        Returns:
            Observations; rewards; whether episodes ended by success, or in failure since an action
            is no number; whether they were cut, by their time or since the physics diverged; infos.

        Raises:
            ConfigError: The actions have another shape, or nothing was reset yet.
        """
        self._require_open()
        if self._over is None:
            raise ConfigError("step: call reset first.")
        chunks = as_actions(actions, self.action_space.shape)
        chunks = chunks if self.options.chunk else chunks[:, None]
        batch, was_over = self.batch, self._over
        rewards = batch.play(chunks)
        everyone = np.arange(self.num_envs)
        if self._mode is AutoresetMode.NEXT_STEP and was_over.any():
            self._begin_fresh(np.flatnonzero(was_over))
        outcome = batch.outcome()
        terminated = outcome.success | outcome.failed
        truncated = outcome.late | outcome.broken
        self._over = outcome.over
        infos = self._infos(everyone)
        observations = batch.observations()
        if self._mode is AutoresetMode.SAME_STEP and self._over.any():
            rows = np.flatnonzero(self._over)
            last = self._final(observations, rows)
            self._begin_fresh(rows)
            infos = last | self._infos(everyone)
            observations = batch.observations()
        return observations, rewards, terminated, truncated, infos

    def render(self) -> tuple[np.ndarray, ...] | None:
        """A picture of each environment, uint8 [H, W, 3], as its first camera sees it."""
        if self.render_mode is None:
            return None
        self._require_open()
        if self._over is None:
            raise ConfigError("render: call reset first.")
        return tuple(self.batch.pictures())

    def _require_open(self) -> None:
        if self.closed:
            raise ConfigError("This environment is closed: make another one.")

    def _seed_with(self, seed: Any, again: np.ndarray) -> None:
        """Makes random numbers anew where there is a seed, or none yet."""
        seeds = seeds_of(seed, self.num_envs)
        for i in np.flatnonzero(again):
            if seeds[i] is not None or self.rngs[i] is None:
                self.rngs[i] = seeding.np_random(seeds[i])[0]

    def _begin_fresh(self, rows: np.ndarray) -> None:
        batch = self.batch
        rngs = [rng for rng in (self.rngs[i] for i in rows) if rng is not None]
        self._begin(rows, fresh(batch.task, batch.world, batch.views, rngs))

    def _begin(self, rows: np.ndarray, begun: Begun) -> None:
        again = np.zeros(self.num_envs, bool)
        again[rows] = True
        self.batch.begin(again, begun)
        self._pair[rows], self._split[rows], self._seed[rows] = begun.pair, begun.split, begun.seed
        over = np.zeros(self.num_envs, bool) if self._over is None else self._over.copy()
        over[rows] = False
        self._over = over

    def _infos(self, rows: np.ndarray) -> dict[str, Any]:
        """What is said of some environments, in Gymnasium's form: a mask beside each array."""
        outcome = self.batch.outcome()
        status = np.full(self.num_envs, "ok", object)
        status[outcome.failed], status[outcome.broken] = "policy", "simulator"
        known = {
            "success": outcome.success,
            "status": status,
            "steps": outcome.steps,
            "pair": self._pair,
            "split": self._split,
            "episode_seed": self._seed,
        }
        mask = np.zeros(self.num_envs, bool)
        mask[rows] = True
        infos: dict[str, Any] = {}
        for name, values in known.items():
            blank = (
                np.full(self.num_envs, None) if values.dtype == object else np.zeros_like(values)
            )
            blank[rows] = values[rows]
            infos |= {name: blank, f"_{name}": mask.copy()}
        return infos

    def _final(self, observations: dict[str, np.ndarray], rows: np.ndarray) -> dict[str, Any]:
        """The last observations and infos of episodes that are over."""
        last = np.full(self.num_envs, None, object)
        for i in rows:
            last[i] = {name: array[i] for name, array in observations.items()}
        mask = np.zeros(self.num_envs, bool)
        mask[rows] = True
        return {
            "final_obs": last,
            "_final_obs": mask,
            "final_info": self._infos(rows),
            "_final_info": mask.copy(),
        }


def as_actions(actions: Any, shape: tuple[int, ...] | None) -> np.ndarray:
    """Actions as numbers of a shape; some may be NaN.

    Raises:
        ConfigError: They are of another shape, or no array of numbers at all.
    """
    try:
        array = np.asarray(actions)
        if array.dtype.kind in "USc":  # text and complex numbers would be converted
            raise TypeError(f"they are {array.dtype}")
        numbers = array if array.dtype.kind == "f" else array.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"step: the actions are no array of numbers: {error}.") from error
    if numbers.shape != shape:
        raise ConfigError(
            f"step: the actions have the shape {list(numbers.shape)}, expected {list(shape or ())}."
        )
    return numbers


def seeds_of(seed: Any, count: int) -> list[int | None]:
    """A seed for each of the environments, or none.

    Args:
        seed: Of the first one, of the next one more; or a list of all.
        count: Environments.

    Raises:
        ConfigError: It is none, or there are more or fewer.
    """
    seeds: list[int | None] = [None] * count
    if isinstance(seed, list | tuple | np.ndarray) and np.ndim(seed) == 1:
        seeds = [None if one is None else whole_number("seed", one) for one in seed]
    elif seed is not None:
        first = whole_number("seed", seed)
        seeds = [first + i for i in range(count)]
    if len(seeds) != count:
        raise ConfigError(f"reset: {len(seeds)} seeds, and there are {count} environments.")
    for one in seeds:
        if one is not None and one < 0:
            raise ConfigError(f"reset: a seed must be 0 or more, got {one}.")
    return seeds


def _autoreset(mode: Any) -> AutoresetMode:
    known = {one.value.lower(): one for one in AutoresetMode}
    known |= {one.name.lower(): one for one in AutoresetMode}
    chosen = mode if isinstance(mode, AutoresetMode) else known.get(str(mode).lower())
    if chosen is None:
        names = [one.value for one in AutoresetMode]
        raise ConfigError(f"Unknown autoreset_mode {mode!r:.80}{closest(str(mode), names)}.")
    return chosen
