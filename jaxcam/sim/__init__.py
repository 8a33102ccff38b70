"""Tasks, physics, controllers and rendering."""

from importlib import import_module

from jaxcam.errors import ConfigError, closest
from jaxcam.sim.task import Task

TASKS: dict[str, str] = {"lift": "jaxcam.sim.tasks.lift:Lift"}
"""Where each task lives, by name."""


def make_task(name: str) -> Task:
    """The task of that name.

    Raises:
        ConfigError: if there is none; the message names the closest.
    """
    if name not in TASKS:
        raise ConfigError(f"Unknown task {name!r}{closest(name, TASKS)}")
    module, cls = TASKS[name].split(":")
    return getattr(import_module(module), cls)()
