"""Temporal ensembling for one who asks at every step: means of all that was predicted for it."""

import numpy as np

from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.sim.actions import POSE, averageable, averaged, is_absolute, is_joint, space_of
from jaxcam.sim.ensemble import ensemble


def check_averages(config: TrainConfig) -> str:
    """The space of a run's actions, if means of them have a meaning.

    Rollouts average the targets that actions lead to. A server knows no targets but those that
    actions are themselves.

    Args:
        config: The run's settings.

    Raises:
        ConfigError: Means of its actions have none, or nobody knows.
    """
    space = space_of(config.action_space, config.rotations)
    if space == "native" and config.action_is == "joint_abs":
        return "joint_abs"
    if is_absolute(space):
        return space
    what = f"actions of {config.action_space}, which say how far to go, not where to"
    if space == "native":
        what = f"a recorded dataset's own actions (--action-is {config.action_is})"
    raise ConfigError(
        f"--ensemble averages actions, and means of {what}, have no meaning. Leave it out, or "
        "train with --action-space eef_abs or joint_abs; of a recorded dataset whose actions are "
        "joint angles, run its training's command again with --action-is joint_abs."
    )


class Averaging:
    """The means of one episode.

    Args:
        space: From `check_averages`.
        rate: How much less each newer prediction weighs, see `jaxcam.sim.ensemble`.
    """

    def __init__(self, space: str, rate: float) -> None:
        self._space, self._rate = space, rate
        self.restart()

    def restart(self) -> None:
        """Forgets what was predicted."""
        self._call, self._mean = 0, np.zeros(0)

    def __call__(self, chunk: np.ndarray) -> np.ndarray:
        """The action for now, as a chunk of one step [1, A].

        Args:
            chunk: What is predicted from now on [T, A].
        """
        chunk = chunk[None].astype(np.float64)
        # What is no pose, the gripper or another arm, is averaged number by number.
        count = chunk.shape[-1] if is_joint(self._space) else len(POSE)
        pose, others = chunk[..., :count], chunk[..., count:]
        numbers = averageable(self._space, pose, np.zeros(pose.shape[:-1]))
        numbers = np.concatenate([others, numbers], -1)
        mean = self._mean if self._call else np.zeros_like(numbers)
        now, self._mean = ensemble(mean, numbers, np.asarray(self._call), self._rate)
        self._call += 1
        others, numbers = np.split(np.asarray(now)[:, None], [others.shape[-1]], -1)
        targets, _ = averaged(self._space, numbers)
        return np.concatenate([targets[0], others[0]], -1).astype(np.float32)
