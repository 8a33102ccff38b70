"""Settings of the forms of `jaxcam.calibrate` that need no tag: the robot's motion is enough."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from jaxcam.config.fields import check_least, check_most, check_types
from jaxcam.config.flags import default
from jaxcam.errors import ConfigError


@dataclass(frozen=True)
class ArmConfig:
    """No tag at all: where a camera stands, from the arm's own motion in its pictures.

    Needs K (from `calibrate lens`, or the dataset's own), the arm's model and its joint angles in
    the dataset. The camera must stand still in the episodes that are used.
    """

    dataset: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="DATASET")]]
    """Folder of a recorded dataset, whose state has the joint angles (rad)."""
    view: Annotated[str, default("none")] = ""
    """The camera's name, as the dataset calls its view."""
    robot: Annotated[str, tyro.conf.arg(metavar="panda|FILE.xml|FILE.urdf")] = "panda"
    """The arm: Franka's Panda with its gripper, or an MJCF or URDF file."""
    joints: Annotated[str, default("by their names")] = ""
    """Where the state has the joint angles, such as observation.state[0:7], from the base on."""
    opening: Annotated[str, default("by its name; else fingers are not looked at")] = ""
    """Where the state has the gripper's opening, such as observation.state[10]."""
    masks: Annotated[str, default("none")] = ""
    """An .npz of another tool that says where the arm is: episode [n], step [n], mask bool
    [n, H, W]."""
    episodes: int = 8
    """Episodes that are used, evenly spaced."""
    most: int = 8
    """Pictures of each episode that are used."""
    cameras: str = "cameras.json"
    """File of calibrations, which gets the pose, and has K unless the dataset says it."""
    out: Annotated[str, default("beside the file of calibrations")] = ""
    """HTML page to write."""

    def __post_init__(self) -> None:
        check_types(self)
        check_least(self, 1, "episodes")
        check_least(self, 3, "most")
        check_most(self, 1000, "episodes most")
        if not self.view:
            raise ConfigError(
                "Which camera? --view is its name in cameras.json, as the dataset calls its view, "
                "for example --view front."
            )


@dataclass(frozen=True)
class DriftConfig:
    """Cameras that moved: by how much, in each episode, pictures ask for another pose.

    Poses are those of the file of calibrations, or the dataset's own. What the arm's motion says of
    each episode is held against what it says of most, and tested against no change.
    """

    dataset: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="DATASET")]]
    """Folder of a recorded dataset, whose state has the joint angles (rad)."""
    view: Annotated[str, default("all")] = ""
    """The only view that is looked at."""
    robot: Annotated[str, tyro.conf.arg(metavar="panda|FILE.xml|FILE.urdf")] = "panda"
    """The arm: Franka's Panda with its gripper, or an MJCF or URDF file."""
    joints: Annotated[str, default("by their names")] = ""
    """Where the state has the joint angles, such as observation.state[0:7], from the base on."""
    opening: Annotated[str, default("by its name; else fingers are not looked at")] = ""
    """Where the state has the gripper's opening, such as observation.state[10]."""
    episodes: int = 200
    """Episodes that are looked at, evenly spaced."""
    most: int = 16
    """Pictures of each that are used."""
    cameras: str = "cameras.json"
    """File of calibrations that has the poses, unless the dataset says them."""
    write: bool = False
    """Put the new poses of episodes in which a camera had moved into the file."""
    out: Annotated[str, default("beside the file of calibrations")] = ""
    """HTML page to write."""

    def __post_init__(self) -> None:
        check_types(self)
        check_least(self, 3, "episodes most")
        check_most(self, 100_000, "episodes")
        check_most(self, 1000, "most")
