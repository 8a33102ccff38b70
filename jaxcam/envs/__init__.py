"""The six tasks as Gymnasium environments, single and batched; importing this registers them.

`gymnasium.make("jaxcam/Lift-v0")` is one environment; `gymnasium.make_vec("jaxcam/Lift-v0", 50)` is
fifty worlds that one engine steps and one painter draws. Both are the same code.
"""

from jaxcam.config.names import TaskName, names_of
from jaxcam.errors import ConfigError

try:
    import gymnasium
    from gymnasium.vector import AutoresetMode  # noqa: F401  (since 1.1)
except ImportError as error:
    raise ConfigError(
        "The environments need gymnasium 1.1 or newer: pip install 'jaxcam[gym]'."
    ) from error

__all__ = ["env_id"]


def env_id(task: TaskName) -> str:
    """Gymnasium's name of a task, such as `jaxcam/PickPlaceCan-v0`."""
    return f"jaxcam/{task.title().replace('_', '')}-v0"


for _task in names_of(TaskName):
    gymnasium.register(
        id=env_id(_task),  # pyright: ignore[reportArgumentType]
        entry_point="jaxcam.envs.single:TaskEnv",
        vector_entry_point="jaxcam.envs.vector:TaskVectorEnv",
        kwargs={"task": _task},
    )
