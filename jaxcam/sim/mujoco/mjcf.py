"""robosuite's models of robot, table and objects as one MJCF: all that robosuite is used for."""

import contextlib
import logging
import warnings
from collections.abc import Iterator, Sequence
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from jaxcam.sim.mujoco.objects import Box, Can, CanGhost, Compound, Object, SquareNut

TABLE_SIZE = (0.8, 0.8, 0.05)
"""Full size of the table (m), robosuite's default."""


class Mjcf(NamedTuple):
    """A model before it is compiled."""

    xml: str
    home: np.ndarray
    """The robot's usual joint angles (rad) [7]."""


def assemble(objects: Sequence[Object], table_top: float) -> Mjcf:
    """The Panda before the table, and objects, each with a free joint `<name>_joint0`.

    Args:
        objects: What there is besides the robot and the table.
        table_top: Height of the table's surface (m).
    """
    models = _robosuite_models()
    robot = models.robots.Panda()
    robot.add_base(models.bases.robot_base_factory(robot.default_base, idn=0))
    robot.add_gripper(models.grippers.PandaGripper(idn="0_right"))
    robot.set_base_xpos(np.asarray(robot.base_xpos_offset["table"](TABLE_SIZE[0]), float))
    arena = models.arenas.TableArena(table_full_size=TABLE_SIZE, table_offset=(0, 0, table_top))
    arena.set_origin([0, 0, 0])
    task = models.tasks.ManipulationTask(
        mujoco_arena=arena,
        mujoco_robots=[robot],
        mujoco_objects=[robosuite_object(thing) for thing in objects],
    )
    return Mjcf(task.get_xml(), np.asarray(robot.init_qpos, float))


def robosuite_object(thing: Object) -> Any:
    """Robosuite's `MujocoObject` of an object."""
    objects = _robosuite_models().objects
    match thing:
        case Box():
            return objects.BoxObject(name=thing.name, size=thing.half_size, rgba=thing.rgba)
        case Can():
            return objects.CanObject(name=thing.name)
        case SquareNut():
            return objects.SquareNutObject(name=thing.name)
        case CanGhost():
            ghost = objects.CanVisualObject(name=thing.name)
            ghost.set_scale(thing.scale)
            for geom in ghost.get_obj().iter("geom"):
                geom.set("rgba", " ".join(f"{part:g}" for part in thing.rgba))
            return ghost
        case Compound(pieces=pieces):
            return objects.CompositeObject(
                name=thing.name,
                total_size=thing.half_size,
                geom_types=[piece.shape for piece in pieces],
                geom_names=[piece.name for piece in pieces],
                geom_sizes=[piece.size for piece in pieces],
                geom_locations=[piece.place for piece in pieces],
                locations_relative_to_center=True,
                obj_types=[piece.role for piece in pieces],
                density=[piece.density for piece in pieces],
                rgba=thing.rgba,
            )


@contextlib.contextmanager
def _without_warnings() -> Iterator[None]:
    disabled = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(disabled)


def _robosuite_models() -> ModuleType:
    """`robosuite.models` with all that is used of it."""
    with _without_warnings():
        # Not above: while it is imported, robosuite warns of parts of it that are not used here.
        import robosuite.models.arenas
        import robosuite.models.bases
        import robosuite.models.grippers
        import robosuite.models.objects
        import robosuite.models.robots
        import robosuite.models.tasks
    return robosuite.models
