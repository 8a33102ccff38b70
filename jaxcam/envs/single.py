"""One environment: the batch of one, behind Gymnasium's `Env`."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import EzPickle
from gymnasium.vector import AutoresetMode

from jaxcam.envs.vector import METADATA, TaskVectorEnv, as_actions, seeds_of
from jaxcam.errors import ConfigError


class TaskEnv(gymnasium.Env[dict[str, np.ndarray], np.ndarray], EzPickle):
    """An environment of one task; see docs/gymnasium.md.

    A copy, or what was pickled, is another environment with the same options.

    Args:
        render_mode: `rgb_array`, or None.
        **options: See `jaxcam.envs.options.EnvOptions`.

    Raises:
        ConfigError: There is no such option, or no such value of it.
        SimError: This machine lacks what the task needs.
    """

    metadata: dict[str, Any] = METADATA

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        EzPickle.__init__(self, render_mode, **options)
        if given := {"num_envs", "autoreset_mode"} & set(options):
            raise ConfigError(f"{', '.join(sorted(given))}: use gymnasium.make_vec.")
        self._one = TaskVectorEnv(1, render_mode, AutoresetMode.DISABLED, **options)
        self.render_mode = render_mode
        self.observation_space = self._one.single_observation_space
        self.action_space = self._one.single_action_space
        self.metadata = {**METADATA, "instruction": self._one.metadata["instruction"]}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begins an episode; see `TaskVectorEnv.reset`.

        Args:
            seed: Of the random numbers that fresh episodes are drawn from.
            options: `pair` and `split`.

        Raises:
            ConfigError: There is no such seed, option or pair.
        """
        if options and "reset_mask" in options:
            raise ConfigError("reset: reset_mask is for several environments, and this is one.")
        super().reset(seed=seeds_of(seed, 1)[0])
        self._one.rngs = [self.np_random]
        observations, infos = self._one.reset(options=options)
        return _first(observations), _first_info(infos)

    def step(
        self, action: np.ndarray
    ) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Executes an action, or a chunk of them; see `TaskVectorEnv.step`.

        Args:
            action: Array [A] or, with the option `chunk`, [chunk, A].

        Raises:
            ConfigError: The action has another shape, or nothing was reset yet.
        """
        actions = as_actions(action, self.action_space.shape)[None]
        observations, rewards, terminated, truncated, infos = self._one.step(actions)
        done = bool(terminated[0]), bool(truncated[0])
        return _first(observations), float(rewards[0]), *done, _first_info(infos)

    def render(self) -> np.ndarray | None:
        """A picture, uint8 [H, W, 3], as the first camera sees it."""
        pictures = self._one.render()
        return None if pictures is None else pictures[0]

    def close(self) -> None:
        """Ends it; it may be called again."""
        self._one.close()


def _first(observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: array[0] for name, array in observations.items()}


def _first_info(infos: dict[str, Any]) -> dict[str, Any]:
    """The info of the first environment, in Python's own types."""
    first = {name: values[0] for name, values in infos.items() if name[0] != "_"}
    return {name: x.item() if isinstance(x, np.generic) else x for name, x in first.items()}
