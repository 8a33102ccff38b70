"""The simulators there are, by the names of what builds, steps and draws their worlds.

Nothing of a simulator is imported before it is used, and only here: tasks and settings can be read
where no simulator is installed.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Literal

from jaxcam.config.names import EngineName

SimulatorName = Literal["mujoco", "sapien"]


@dataclass(frozen=True)
class LazyPart:
    """A class or function of a simulator's modules, imported when it is first used."""

    module: str
    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    """Keyword arguments for every call."""

    def load(self) -> Any:
        """The class or function, imported if need be."""
        return getattr(import_module(self.module), self.name)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Calls the class or function with `options` added."""
        return self.load()(*args, **{**self.options, **kwargs})


@dataclass(frozen=True)
class Simulator:
    """What makes worlds of one kind, and what steps and draws them."""

    world: LazyPart
    """`(task, scene name) -> World`; the same world for the same arguments."""
    engines: Mapping[EngineName, LazyPart]
    """`(world, controller, varied) -> Engine`. The first makes demonstrations, and is the fastest
    without an accelerator."""
    accelerated: EngineName
    """The fastest engine with an accelerator."""
    has_accelerator: LazyPart
    """`() -> bool`: whether this machine has one that this simulator can use."""
    painter: LazyPart
    """`(world, height, width, varied=..., batch=...) -> Painter`: draws with an accelerator, and
    inside the programs of compiled engines."""
    cpu_painter: LazyPart
    """The same, and the fastest without an accelerator."""
    packages: tuple[str, ...]
    """Distributions whose versions shape what happens in its worlds."""


SIMULATORS: Mapping[SimulatorName, Simulator] = {
    "mujoco": Simulator(
        world=LazyPart("jaxcam.sim.mujoco.scene", "scene_of"),
        engines={
            "native": LazyPart("jaxcam.sim.mujoco.native", "NativeEngine"),
            "mjx-jax": LazyPart("jaxcam.sim.mujoco.mjx", "MjxEngine", {"impl": "jax"}),
            "mjx-warp": LazyPart("jaxcam.sim.mujoco.mjx", "MjxEngine", {"impl": "warp"}),
        },
        accelerated="mjx-warp",
        has_accelerator=LazyPart("jaxcam.sim.mujoco.machine", "has_accelerator"),
        painter=LazyPart("jaxcam.sim.mujoco.render", "Renderer"),
        cpu_painter=LazyPart("jaxcam.sim.mujoco.tracer.painter", "CpuRenderer"),
        packages=("mujoco", "robosuite"),
    ),
    "sapien": Simulator(
        world=LazyPart("jaxcam.sim.maniskill.scene", "scene_of"),
        engines={
            "sapien": LazyPart("jaxcam.sim.maniskill.engine", "SapienEngine"),
            "sapien-gpu": LazyPart("jaxcam.sim.maniskill.engine", "SapienEngine", {"on_gpu": True}),
        },
        accelerated="sapien-gpu",
        has_accelerator=LazyPart("jaxcam.sim.maniskill.machine", "has_accelerator"),
        painter=LazyPart("jaxcam.sim.maniskill.render", "SapienPainter"),
        cpu_painter=LazyPart("jaxcam.sim.maniskill.render", "SapienPainter"),
        packages=("mani-skill", "sapien", "torch"),
    ),
}
