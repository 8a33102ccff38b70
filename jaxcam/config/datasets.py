"""Settings of the commands that make datasets, replay them or carry them to other formats."""

from dataclasses import dataclass, fields
from typing import Annotated, Self

import tyro

from jaxcam.config.conditions import OPTICS, keep_canonical
from jaxcam.config.fields import (
    check_least,
    check_most,
    check_seeds,
    check_types,
    check_window,
)
from jaxcam.config.flags import PRESET, FromPreset, default
from jaxcam.config.names import (
    ActionSpace,
    CommandSource,
    EngineChoice,
    SceneName,
    TaskName,
)
from jaxcam.config.sizes import rows_and_columns
from jaxcam.config.train import MOST_DEMOS, TrainConfig
from jaxcam.errors import ConfigError


@dataclass(frozen=True)
class CollectConfig:
    """Collect demonstrations of the scripted expert: states, commands and camera poses."""

    task: TaskName = "lift"
    """What the robot has to do."""
    scene: SceneName = "randomized"
    """Whether robot and table stand still or move from episode to episode."""
    demos: int = 200
    """Training demonstrations."""
    validation: int = 10
    """Validation demonstrations."""
    n: Annotated[FromPreset[int], default("the task's")] = PRESET
    """Cameras a demonstration is seen from."""
    m: Annotated[FromPreset[int], default("the task's")] = PRESET
    """How many cameras later the cameras of the next demonstration begin; 0 gives all the same."""
    fovy: Annotated[str, tyro.conf.arg(metavar="LOW:HIGH"), default("the task's")] = ""
    """Vertical fields of view of the cameras, in degrees, such as 35:55."""
    aspect: Annotated[str, tyro.conf.arg(metavar="LOW:HIGH"), default("1")] = ""
    """Width over height of what a square picture shows, such as 1:1.5."""
    centre: Annotated[str, tyro.conf.arg(metavar="LOW:HIGH"), default("0")] = ""
    """Distance of the principal point from the picture's middle, in heights of it."""
    lens: Annotated[str, tyro.conf.arg(metavar="MODEL:LOW:HIGH,..."), default("none")] = ""
    """Lenses: opencv or fisheye, and a range for each coefficient, such as opencv:-0.3:0."""
    seed: int = 0
    """Seed of the initial states and of the expert."""
    data_dir: str = "data"
    """Folder of the datasets."""

    @classmethod
    def of(cls, config: TrainConfig) -> Self:
        """The dataset that a run trains on; every training seed shares it."""
        names = [f.name for f in fields(cls) if f.name != "seed"]
        return cls(**{name: getattr(config, name) for name in names})

    def __post_init__(self) -> None:
        check_types(self)
        keep_canonical(self, *OPTICS)
        check_least(self, 1, "demos n")
        check_least(self, 0, "validation m")
        check_most(self, MOST_DEMOS, "demos validation n m")
        check_seeds(self.seed)
        check_window(self.n, self.m)


@dataclass(frozen=True)
class ReplayConfig:
    """Replay demonstrations in each action space and count how many succeed."""

    dataset: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="DATASET")]]
    """HDF5 file of demonstrations; one of ManiSkill's is imported first (`jaxcam.maniskill`)."""
    action_space: Annotated[tuple[ActionSpace, ...], default("the paper's four")] = ()
    """Action spaces to replay in."""
    engine: EngineChoice = "auto"
    """What steps the physics."""

    def __post_init__(self) -> None:
        check_types(self)


@dataclass(frozen=True)
class ImportConfig:
    """Import demonstrations of others by their states."""

    file: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="FILE")]]
    """File to import."""
    out: Annotated[
        str | None, tyro.conf.arg(metavar="STR"), default("data/TASK-SCENE-FILE.hdf5")
    ] = None
    """Dataset to write; train on it with `python -m jaxcam.train --dataset`."""
    scene: SceneName = "randomized"
    """Whether the table and the room that are seen stand still or move from episode to episode."""
    validation: Annotated[
        int | None,
        tyro.conf.arg(metavar="INT"),
        default("every tenth, one at least, or as the file says"),
    ] = None
    """Validation demonstrations, the last ones."""
    n: Annotated[FromPreset[int], default("the task's")] = PRESET
    """Cameras a demonstration is seen from."""
    m: Annotated[FromPreset[int], default("the task's")] = PRESET
    """How many cameras later the cameras of the next demonstration begin; 0 gives all the same."""

    def __post_init__(self) -> None:
        check_types(self)
        check_least(self, 1, "n")
        check_least(self, 0, "validation m")
        check_most(self, MOST_DEMOS, "validation n m")
        check_window(self.n, self.m)


@dataclass(frozen=True)
class RobomimicConfig(ImportConfig):
    """Import robomimic's demonstrations of robosuite, an HDF5 file, by replaying their states."""

    task: TaskName = "lift"
    """What the robot has to do."""
    actions: CommandSource = "commands"
    """Where commands come from: the file's own OSC_POSE actions as its `env_args` say, or read as
    deltas or as absolute poses whatever they say, or the poses that its states reach, which every
    file has."""
    filter_key: Annotated[str | None, tyro.conf.arg(metavar="STR"), default("all")] = None
    """Import only the demonstrations of this entry of the file's `mask`; KEY_train and KEY_valid
    split them where the file has these."""


@dataclass(frozen=True)
class ManiskillConfig(ImportConfig):
    """Import ManiSkill's trajectories, HDF5 with JSON beside it, and replay them in each space."""


@dataclass(frozen=True)
class LerobotConfig:
    """Export a dataset in LeRobot's v3 format: Parquet, MP4 and metadata with the cameras."""

    dataset: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="DATASET")]]
    """HDF5 file of demonstrations."""
    out: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="FOLDER")]]
    """Folder to write."""
    resolution: int | str = 256
    """Size of the images in pixels, a side or rows x columns, even numbers; 84 shares the pictures
    of the preset laptop."""
    action_space: ActionSpace = "eef_delta"
    """What the actions mean."""
    instruction: Annotated[str | None, tyro.conf.arg(metavar="STR"), default("the task")] = None
    """The task in words, for policies that read."""
    validation: bool = False
    """Export the validation demonstrations, seen by one held-out camera each."""

    def __post_init__(self) -> None:
        check_types(self)
        if any(side % 2 for side in rows_and_columns(self.resolution)):
            raise ConfigError(f"resolution must be even for video, got {self.resolution}.")
