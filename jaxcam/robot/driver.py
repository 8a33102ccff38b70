"""What a robot has to provide to be driven by us. `docs/robot.md` tells it at length."""

import importlib
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np

from jaxcam.errors import ConfigError, JaxcamError


@dataclass(frozen=True)
class Setup:
    """How a rollout begins.

    Attributes:
        start: Number of the start, from 0.
        words: The start, as the sheet says it.
        placement: Where the cameras stand, as the cameras file calls it; empty if they never move.
        cameras: Of every camera whose calibration is known, K [3, 3], the size (rows, columns)
            that it is for, and `base_from_camera` [4, 4].
        lenses: Of those that have one, what `jaxcam.rays.lens.pack` gives for it [9].
    """

    start: int
    words: str
    placement: str
    cameras: Mapping[str, tuple[np.ndarray, tuple[int, int], np.ndarray]]
    lenses: Mapping[str, np.ndarray] = field(default_factory=dict)


class Robot(Protocol):
    """A robot, or a simulated one. All calls come from one thread.

    What it may have beside this: `action_space`, so that policies of another one are refused;
    `outcome() -> str | None`, how the rollout ended ("success", "half" or "failure") if it knows,
    so that the operator only has to agree; and, if it is simulated, `speed`, how much faster than
    real time it is. Where that is 0, steps follow each other as fast as they can, and time stands
    still while a policy thinks.
    """

    rate: float
    """Control steps a second."""

    def prepare(self, setup: Setup) -> None:
        """Bring the robot to where rollouts start; the operator has put the objects there."""
        ...

    def observe(self) -> Mapping[str, Any]:
        """What it sees now.

        Returns:
            `observation.images.<camera>` uint8 [H, W, 3] of every camera of the sheet,
            `observation.state` float32 [P], and what else the policies are to be sent.
        """
        ...

    def act(self, action: np.ndarray) -> None:
        """Execute one step's action [A], and return at once."""
        ...

    def hold(self) -> None:
        """Stay at the last target for one step."""
        ...

    def stop(self) -> None:
        """Come to rest where it is. Also called after an error, and before `prepare`."""
        ...


_WANTED = ("prepare", "observe", "act", "hold", "stop")


def make_robot(name: str, settings: Mapping[str, Any], folder: Path) -> Robot:
    """The robot that a sheet names.

    Args:
        name: "module:Class"; the module may lie beside the sheet.
        settings: What the class is called with.
        folder: Of the sheet.

    Raises:
        ConfigError: There is none, it does not take these settings, or it lacks something.
    """
    module_name, _, kind_name = name.partition(":")
    parts = [*module_name.split("."), kind_name]
    if not all(part.isidentifier() for part in parts):
        raise ConfigError(f"robot: {name!r} is no 'module:Class', and not 'none'.")
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"robot: the module {module_name!r} cannot be imported: {error}. It is looked for in "
            f"{folder} and among what is installed."
        ) from error
    except Exception as error:  # whatever it is, it is the module's own
        raise ConfigError(
            f"robot: the module {module_name!r} cannot be imported: {type(error).__name__}: {error}"
        ) from error
    kind = getattr(module, kind_name, None)
    if not callable(kind):
        where = getattr(module, "__file__", None) or module_name
        raise ConfigError(f"robot: {where} has no class {kind_name!r}.")
    try:
        robot = kind(**settings)
    except TypeError as error:
        raise ConfigError(f"robot: {name} does not take these robot_settings: {error}.") from error
    except JaxcamError:
        raise
    except Exception as error:  # such as a robot that is switched off
        raise ConfigError(
            f"robot: {name} could not be made: {type(error).__name__}: {error}. Is the robot on, "
            "and are the robot_settings right?"
        ) from error
    missing = [part for part in _WANTED if not callable(getattr(robot, part, None))]
    rate = getattr(robot, "rate", None)
    speed = getattr(robot, "speed", 1.0)
    if not isinstance(rate, int | float) or not 0 < rate < 10_000:
        missing.append("rate, its control steps a second")
    if not isinstance(speed, int | float) or not 0 <= speed < 10_000:
        missing.append("a speed that is a number from 0 on")
    if missing:
        raise ConfigError(
            f"robot: {name} lacks {', '.join(missing)}. docs/robot.md says what a robot provides."
        )
    return cast(Robot, robot)
