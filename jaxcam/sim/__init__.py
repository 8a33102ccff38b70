"""Worlds: tasks, experts, controllers, and the engines and painters of two simulators."""

import pkgutil
from collections.abc import Sequence
from importlib import import_module
from typing import Any

from jaxcam.config.names import EngineName
from jaxcam.errors import ConfigError, closest
from jaxcam.sim import tasks
from jaxcam.sim.engine import Engine
from jaxcam.sim.lenses import SCALE, LensPainter
from jaxcam.sim.painter import Painter
from jaxcam.sim.simulators import SIMULATORS, Simulator
from jaxcam.sim.task import Task
from jaxcam.sim.types import ControllerName
from jaxcam.sim.world import World

__all__ = [
    "engine_name",
    "make_engine",
    "make_painter",
    "make_task",
    "painter_of",
    "simulator_of",
    "task_names",
]


def task_names() -> tuple[str, ...]:
    """Names of all tasks: every file in `jaxcam/sim/tasks` is one."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(tasks.__path__)))


def make_task(name: str) -> Task:
    """The task of that name: the one in `jaxcam/sim/tasks/<name>.py`. It loads no simulator.

    Raises:
        ConfigError: If there is none; the message names the closest.
    """
    if name not in task_names():
        raise ConfigError(f"Unknown task {name!r}{closest(name, task_names())}")
    module = vars(import_module(f"{tasks.__name__}.{name}"))
    return next(x for x in module.values() if isinstance(x, type) and vars(x).get("name") == name)()


def simulator_of(world: World | Task) -> Simulator:
    """What steps and draws a world, or the worlds of a task."""
    return SIMULATORS[world.simulator]


def engine_name(name: str, world: World | Task) -> EngineName:
    """The engine meant by a setting.

    Args:
        name: `auto`, or an engine's. `auto` is the world's fastest on this machine.
        world: The world, or a task for all of its worlds, which need not be loaded then.

    Raises:
        ConfigError: If there is no such engine, or it cannot step this world.
    """
    simulator = simulator_of(world)
    if name == "auto":
        accelerated = simulator.has_accelerator()
        return simulator.accelerated if accelerated else next(iter(simulator.engines))
    for known in simulator.engines:
        if name == known:
            return known
    engines = [engine for one in SIMULATORS.values() for engine in one.engines]
    if name not in engines:
        raise ConfigError(f"Unknown engine {name!r}{closest(name, ['auto', *engines])}")
    raise ConfigError(
        f"The engine {name!r} cannot step this task's world; auto, or one of "
        f"{', '.join(simulator.engines)}, can."
    )


def make_engine(
    name: str | None, world: World, controller: ControllerName, varied: Sequence[str] = ()
) -> Engine:
    """The engine of that name.

    Args:
        name: See `engine_name`; None is the one that makes demonstrations.
        world: The world that is stepped.
        controller: `osc_pose` or `joint_position`.
        varied: Geoms whose sizes differ between episodes.

    Raises:
        ConfigError: If there is none, or it cannot run the world; the message says which can.
    """
    engines = simulator_of(world).engines
    chosen = next(iter(engines)) if name is None else engine_name(name, world)
    return engines[chosen](world, controller, varied)


def make_painter(
    world: World,
    height: int,
    width: int | None = None,
    *,
    varied: Sequence[str] = (),
    batch: int = 32,
    engine: EngineName | None = None,
    lenses: bool = False,
) -> Painter:
    """What draws a world.

    Args:
        world: The world.
        height: Of the pictures (pixels).
        width: Of the pictures (pixels); `height` when None.
        varied: The task's varied geoms.
        batch: Views that it is to draw at once: more only take longer, but some painters draw as
            many when there are fewer. The pictures are the same.
        engine: That steps the world, see `painter_of`.
        lenses: Whether views may have lenses.
    """
    painter: Any = painter_of(world, engine)
    width = width or height

    def made(scale: int) -> Painter:
        size = (scale * height, scale * width)
        return painter(world, *size, varied=tuple(varied), batch=batch)

    return LensPainter(made(1), made(SCALE)) if lenses else made(1)


def painter_of(world: World, engine: EngineName | None = None) -> type[Painter]:
    """The class of what draws a world on this machine: its `look`, and whether it `uses_all_cores`.

    Args:
        world: The world.
        engine: That steps it, if it is one that draws within its own program (MJX's).
    """
    simulator = simulator_of(world)
    if (engine or "").startswith("mjx") or simulator.has_accelerator():
        return simulator.painter.load()
    painter: type[Painter] = simulator.cpu_painter.load()
    return painter if painter.draws(world) else simulator.painter.load()
