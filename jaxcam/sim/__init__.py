"""Tasks, physics, controllers and rendering."""

from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, get_args

from jaxcam.config.names import EngineName, TaskName
from jaxcam.errors import ConfigError, closest

if TYPE_CHECKING:
    from jaxcam.sim.engine import ControllerName, Engine
    from jaxcam.sim.task import Task
    from jaxcam.sim.world import World


def make_task(name: str) -> "Task":
    """The task of that name: the one in `jaxcam/sim/tasks/<name>.py`.

    Raises:
        ConfigError: if there is none; the message names the closest.
    """
    if name not in get_args(TaskName):
        raise ConfigError(f"Unknown task {name!r}{closest(name, get_args(TaskName))}")
    module = vars(import_module(f"jaxcam.sim.tasks.{name}"))
    return next(x for x in module.values() if isinstance(x, type) and vars(x).get("name") == name)()


def engine_name(name: str, scene: "World") -> str:
    """The engine meant by a setting.

    Args:
        name: `auto`, or an engine's. `auto` is the world's fastest on this machine.
        scene: the world.

    Raises:
        ConfigError: if there is no such engine, or it cannot step this world.
    """
    if name not in get_args(EngineName):
        raise ConfigError(f"Unknown engine {name!r}{closest(name, get_args(EngineName))}")
    if name != "auto":
        if name not in scene.engines:
            raise ConfigError(
                f"The engine {name!r} cannot step this task's world; auto, or one of "
                f"{', '.join(scene.engines)}, can."
            )
        return name
    return scene.fastest_engine


def make_engine(
    name: str, scene: "World", controller: "ControllerName", varied: Sequence[str] = ()
) -> "Engine":
    """The engine of that name.

    Args:
        name: see `engine_name`.
        scene: the world that is stepped.
        controller: `osc_pose` or `joint_position`.
        varied: geoms whose sizes differ between episodes.

    Raises:
        ConfigError: if there is none, or it cannot run the scene; the message says which can.
    """
    return scene.engine(engine_name(name, scene), controller, varied)
