"""Tasks, physics, controllers and rendering."""

from collections.abc import Sequence
from importlib import import_module

from jaxcam.errors import ConfigError, closest
from jaxcam.presets import NAMES
from jaxcam.sim.engine import ControllerName, Engine
from jaxcam.sim.scene import Scene
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


def engine_name(name: str) -> str:
    """The engine meant by a setting: `auto` is mjx-warp on an accelerator, native without one."""
    import jax

    if name != "auto":
        return name
    return "native" if jax.default_backend() == "cpu" else "mjx-warp"


def make_engine(
    name: str, scene: Scene, controller: ControllerName, varied: Sequence[str] = ()
) -> Engine:
    """The engine of that name.

    Args:
        name: `auto`, `native`, `mjx-jax` or `mjx-warp`.
        scene: whose physics model is stepped.
        controller: `osc_pose` or `joint_position`.
        varied: geoms whose sizes differ between episodes.

    Raises:
        ConfigError: if there is none, or it cannot run the scene; the message says which can.
    """
    if name not in NAMES["engine"]:
        raise ConfigError(f"Unknown engine {name!r}{closest(name, NAMES['engine'])}")
    name = engine_name(name)
    if name == "native":
        from jaxcam.sim.native import NativeEngine

        return NativeEngine(scene, controller, varied)
    from jaxcam.sim.mjx import MjxEngine

    return MjxEngine(scene, controller, varied, "jax" if name == "mjx-jax" else "warp")
