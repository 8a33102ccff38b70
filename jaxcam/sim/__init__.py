"""Tasks, physics, controllers and rendering."""

from importlib import import_module

from jaxcam.errors import ConfigError, closest
from jaxcam.presets import NAMES
from jaxcam.sim.task import Task


def make_task(name: str) -> Task:
    """The task of that name: the one in `jaxcam/sim/tasks/<name>.py`.

    Raises:
        ConfigError: if there is none; the message names the closest.
    """
    if name not in NAMES["task"]:
        raise ConfigError(f"Unknown task {name!r}{closest(name, NAMES['task'])}")
    import_module(f"jaxcam.sim.tasks.{name}")
    return next(task for task in Task.__subclasses__() if task.name == name)()
