"""Settings of commands around training: evaluate, report, check, weights. Help needs no JAX."""

import dataclasses
from dataclasses import dataclass
from typing import Annotated, ClassVar

import tyro

from jaxcam.config.conditions import Conditions, several
from jaxcam.config.fields import check_least, check_most, check_rotation_form, check_types
from jaxcam.config.flags import Groups, default
from jaxcam.config.foreign import ForeignConfig
from jaxcam.config.names import (
    ActionSpace,
    Cluster,
    EngineChoice,
    EvaluationSplit,
    ProtocolName,
    Rotations,
    SceneName,
    Split,
    TaskName,
)
from jaxcam.errors import ConfigError


@dataclass(frozen=True)
class EvaluateConfig:
    """Evaluate runs on held-out initial states and camera poses; what has a row is not run again.

    The same command run again goes on with what is missing. Somebody else's policy is evaluated
    with --policy: see --help policy.
    """

    GROUPS: ClassVar[Groups] = {
        "": "run protocol step pairs split width engine ensemble videos distributed",
        "conditions": "pose_noise pose_drift fovy lens centre aspect",
        "policy": "foreign",
    }

    run: tyro.conf.Positional[
        Annotated[
            tuple[str, ...],
            tyro.conf.arg(metavar="RUN ...", help_behavior_hint="(or --policy)"),
        ]
    ] = ()
    """Folders of runs."""
    protocol: ProtocolName = "one"
    """one is a single checkpoint; paper is the last 10 checkpoints on 50 pairs each (3 seeds are 3
    runs)."""
    step: Annotated[int | None, tyro.conf.arg(metavar="INT"), default("newest whole one")] = None
    """Checkpoint to evaluate."""
    pairs: int = 50
    """(Initial state, camera pose) pairs."""
    split: EvaluationSplit = "test"
    """Which pairs: test is kept for results, validation is for choosing settings; train is new
    initial states on cameras that training saw, which tells memory from generalisation and is no
    result."""
    width: int = 50
    """Rollouts simulated at once; rows of different widths are not mixed."""
    engine: EngineChoice = "auto"
    """Physics; auto is mjx-warp on an accelerator and native without, and for the tasks of
    ManiSkill sapien-gpu on an NVIDIA card and sapien without. Rows of different engines are not
    mixed."""
    ensemble: Annotated[float | None, tyro.conf.arg(metavar="FLOAT"), default("as in training")] = (
        None
    )
    """Rate of temporal ensembling, 0 is off. Rows of different rates are not mixed."""
    pose_noise: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="DEG,CM ..."), default("none")
    ] = ()
    """Error of the camera poses that the policy is told, one throughout an episode and the same for
    all policies: a turn in degrees and a shift in centimetres. Each of several is evaluated, as are
    all combinations with what follows; rows of each are kept apart."""
    pose_drift: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="DEG,CM ..."), default("none")
    ] = ()
    """By how much a further error grows every second, always in one direction."""
    fovy: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="LOW:HIGH ..."), default("as in the run's own")
    ] = ()
    """Vertical fields of view of the cameras, in degrees; nominal is the task's."""
    aspect: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="LOW:HIGH ..."), default("as in training")
    ] = ()
    """Width over height of what a square picture shows."""
    centre: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="LOW:HIGH ..."), default("as in training")
    ] = ()
    """Distance of the principal point from the picture's middle, in heights of it."""
    lens: Annotated[
        tuple[str, ...],
        tyro.conf.arg(metavar="MODEL:LOW:HIGH,... ..."),
        default("as in training"),
    ] = ()
    """Lenses: opencv or fisheye, and a range for each coefficient."""
    videos: int = 16
    """Rollouts in each of two videos, one of the first pairs and one of failures; 0 is none."""
    distributed: bool = False
    """Be one of several processes that share the rollouts; they find each other as those of
    `jaxcam.train --distributed` do."""
    foreign: tyro.conf.OmitArgPrefixes[ForeignConfig] = dataclasses.field(
        default_factory=ForeignConfig
    )

    def __post_init__(self) -> None:
        check_types(self)
        check_least(self, 1, "pairs width")
        check_least(self, 0, "step videos")
        check_most(self, 1_000_000, "pairs width videos")
        check_least(self, -1, "ensemble")
        self.conditions(Conditions())
        if self.foreign.policy:
            self._check_foreign()
        elif not self.run:
            raise ConfigError("No run is given. Name one run folder or several, or a --policy.")
        if self.protocol == "paper" and (self.step is not None or self.pairs != 50):
            raise ConfigError("protocol paper has its own checkpoints and 50 pairs: leave out "
                              "--step and --pairs.")  # fmt: skip
        if self.protocol == "paper" and self.split == "train":
            raise ConfigError(
                "protocol paper gives results, and those are on cameras that training did not see: "
                "leave out --protocol, or --split train."
            )

    def conditions(self, usual: Conditions) -> list[Conditions]:
        """All conditions that are asked for, one after the other.

        Args:
            usual: What those have of which nothing is asked: a run's own cameras.

        Raises:
            ConfigError: One cannot be.
        """
        return several(usual, {f.name: getattr(self, f.name) for f in dataclasses.fields(usual)})

    def _check_foreign(self) -> None:
        """Refuses what only checkpoints have."""
        if self.run:
            raise ConfigError("Give runs or --policy, not both.")
        if self.protocol == "paper":
            raise ConfigError(
                "protocol paper judges the last 10 checkpoints of a run, and --policy is one "
                "policy: leave out --protocol."
            )
        if self.split == "train":
            raise ConfigError("--split train is for runs: nobody says which cameras another policy "
                              "was trained on.")  # fmt: skip
        for name in ("step", "ensemble", "distributed"):
            if getattr(self, name) != getattr(EvaluateConfig, name):
                raise ConfigError(f"--{name} is for runs, not for --policy.")
        if self.engine.startswith("mjx"):
            raise ConfigError(
                f"engine {self.engine} steps worlds and policy in one program, and --policy is "
                "asked from outside of it: use native, or auto."
            )


@dataclass(frozen=True)
class ReportConfig:
    """Compare runs with each other and with the paper: tables, figures and one HTML page."""

    runs: tyro.conf.Positional[
        Annotated[
            tuple[str, ...], tyro.conf.arg(metavar="RUN ...", help_behavior_hint="(required)")
        ]
    ]
    """Run folders, folders of runs, or folders that this command wrote."""
    out: str = "report"
    """Folder to write."""
    split: Split = "test"
    """Which pairs: those kept for results, or those for choosing settings."""
    pack: Annotated[str, default("none")] = ""
    """Folder to write a result pack to instead: the rollouts with digests, to be given to others,
    see docs/benchmark.md."""
    pack_name: Annotated[str, default("the folder's name")] = ""
    """What the pack is called on a leaderboard."""
    authors: Annotated[str, default("none")] = ""
    """Whose the pack is."""
    link: Annotated[str, default("none")] = ""
    """Where more is to be read about it, such as https://example.org/paper."""
    leaderboard: Annotated[str, default("none")] = ""
    """HTML page to write instead, over all the packs that are given."""

    def __post_init__(self) -> None:
        check_types(self)
        if not self.runs:
            raise ConfigError("No run is given. Name run folders, or folders that hold some.")
        _check_only_with(self, "pack", "pack_name authors link")
        if self.pack and self.leaderboard:
            raise ConfigError("Give --pack or --leaderboard, not both.")
        if (self.pack or self.leaderboard) and self.out != ReportConfig.out:
            raise ConfigError("--out is the folder of a report, which --pack and --leaderboard do "
                              "not write: leave it out.")  # fmt: skip


@dataclass(frozen=True)
class CheckConfig:
    """Look for what is wrong with a dataset, a run or this machine; exit code 1 if anything is."""

    target: tyro.conf.Positional[
        Annotated[str, tyro.conf.arg(metavar="[DATASET|RUN]"), default("none")]
    ] = ""
    """A dataset (also a file of robomimic's or ManiSkill's, as it would be imported, or a recorded
    dataset's folder) or a run's folder."""
    env: bool = False
    """Check this machine: packages, accelerator, folders, Vulkan device, ManiSkill."""
    episodes: int = 8
    """Demonstrations that are replayed, drawn, and compared with cached pictures."""
    cameras: Annotated[str, default("the dataset's own")] = ""
    """JSON file that says where the cameras of a recorded dataset stood."""
    grip: Annotated[str, default("by its names")] = ""
    """Where a recorded dataset's state has the grip's position, such as observation.state[0:3]."""
    robot: Annotated[str, default("not looked at")] = ""
    """Arm of a recorded dataset, panda or an MJCF or URDF file: by its motion cameras are held
    against their poses where table and room do not tell."""
    out: Annotated[str, default("beside what is checked")] = ""
    """HTML page to write."""

    def __post_init__(self) -> None:
        check_types(self)
        check_least(self, 0, "episodes")
        check_most(self, 1_000_000, "episodes")
        if self.env and self.target:
            raise ConfigError("Give --env or something to check, not both.")
        if self.env and self.out:
            raise ConfigError("--env writes no page: leave out --out.")
        if not (self.env or self.target):
            raise ConfigError("Nothing to check. Name a dataset or a run's folder, or give --env.")


@dataclass(frozen=True)
class ViewConfig:
    """Look at a dataset, a run's rollouts or calibrated cameras in a browser; Ctrl-C ends.

    Of two targets, one is laid over the other.
    """

    target: tyro.conf.Positional[
        Annotated[
            tuple[str, ...],
            tyro.conf.arg(metavar="DATASET|RUN|CAMERAS.json ...", help_behavior_hint="(required)"),
        ]
    ]
    """A dataset (also a file of robomimic's or ManiSkill's, or a recorded dataset's folder), a
    run's folder, or a file of calibrations; one or two."""
    episode: Annotated[int | None, tyro.conf.arg(metavar="INT"), default("the first")] = None
    """Demonstration, recorded episode, or a run's held-out pair to begin with."""
    save: Annotated[str, default("none")] = ""
    """HTML page to write instead: one file that needs neither a server nor a network."""
    port: int = 8080
    """Port of this machine to listen at; 0 takes one that is free and tells which."""
    split: Split = "test"
    """Which pairs of a run."""
    step: Annotated[int | None, tyro.conf.arg(metavar="INT"), default("all, the newest first")] = (
        None
    )
    """Whose rollouts of a run: of which checkpoint."""
    cameras: Annotated[str, default("the dataset's own")] = ""
    """JSON file that says where the cameras of a recorded dataset stood."""
    grip: Annotated[str, default("by its names")] = ""
    """Where a recorded dataset's state has the grip's position, such as observation.state[0:3]."""

    def __post_init__(self) -> None:
        check_types(self)
        check_least(self, 0, "episode port step")
        check_most(self, 65535, "port")
        if not 1 <= len(self.target) <= 2:
            raise ConfigError(
                f"{len(self.target)} targets are given. Name a dataset, a run's folder or a file "
                "of cameras, or two of them."
            )
        if self.save and self.port != ViewConfig.port:
            raise ConfigError("--save writes a file and serves nothing: leave out --port.")


@dataclass(frozen=True)
class SweepConfig:
    """Train and evaluate all runs of a grid; what is done is skipped, what was stopped goes on."""

    grid: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="GRID.yaml")]]
    """YAML file; grids/ has one for every table and figure of the paper."""
    jobs: int = 1
    """Runs at once."""
    cluster: Cluster = "none"
    """Where runs go: none is this machine; slurm goes through submitit (extra `sweep`), and local
    does so on this machine, to try it."""
    retries: int = 3
    """How often a run that was killed or preempted is started again."""
    list: bool = False
    """Print the runs, how far they are and their commands, and start nothing."""

    def __post_init__(self) -> None:
        check_types(self)
        check_least(self, 1, "jobs")
        check_most(self, 1000, "jobs")
        check_least(self, 0, "retries")
        check_most(self, 1_000_000, "retries")


@dataclass(frozen=True)
class WeightsConfig:
    """Look at a file of weights, or convert a policy to or from a LeRobot checkpoint."""

    source: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="FILE|FOLDER")]]
    """A .safetensors, .pt or .pth file to look at; or a folder: of a run, with --export, or of a
    LeRobot checkpoint, with --run-dir."""
    export: Annotated[str, default("none")] = ""
    """Folder to write the run's policy to, as a LeRobot checkpoint."""
    step: Annotated[int | None, tyro.conf.arg(metavar="INT"), default("newest whole one")] = None
    """The run's checkpoint to export."""
    run_dir: Annotated[str, default("none")] = ""
    """Folder of a new run, made of the LeRobot checkpoint, for `python -m jaxcam.evaluate`."""
    task: TaskName = "lift"
    """What that policy was trained to do."""
    scene: SceneName = "randomized"
    """In which scene."""
    action_space: ActionSpace = "eef_delta"
    """What its actions mean."""
    rotations: Rotations = "nominal"
    """What the rotation vectors of eef_abs are counted from; world for what learned from a dataset
    that version 0.1.0 exported."""

    def __post_init__(self) -> None:
        check_types(self)
        check_rotation_form(self.action_space, self.rotations)
        if self.export and self.run_dir:
            raise ConfigError("Give --export or --run-dir, not both.")
        check_least(self, 0, "step")
        _check_only_with(self, "export", "step")
        _check_only_with(self, "run_dir", "task scene action_space rotations")


def _check_only_with(config: WeightsConfig | ReportConfig, flag: str, fields: str) -> None:
    """Refuses settings that mean nothing without a flag: they would be forgotten without a word."""
    for field in fields.split():
        if not getattr(config, flag) and getattr(config, field) != getattr(type(config), field):
            names = (f"--{name.replace('_', '-')}" for name in (field, flag))
            raise ConfigError("{} goes with {} only.".format(*names))


@dataclass(frozen=True)
class TrialConfig:
    """Try policies on a robot: in random order, blinded, rated by who watches; then the report.

    The same command run again goes on with what is missing.
    """

    sheet: tyro.conf.Positional[
        Annotated[
            tuple[str, ...],
            tyro.conf.arg(metavar="SHEET.yaml ...", help_behavior_hint="(required)"),
        ]
    ]
    """What is tried: docs/robot.md has its entries. Several only with --report."""
    out: Annotated[str, default("beside the sheet")] = ""
    """Folder of the rows and the report; with several sheets, of the report."""
    report: bool = False
    """Write the report on what there is so far, and run nothing. It says which policy is which."""
    list: bool = False
    """Print the rollouts in order, and run nothing."""

    def __post_init__(self) -> None:
        check_types(self)
        if not self.sheet:
            raise ConfigError("No sheet is given. Name a YAML file; docs/robot.md has an example.")
        if len(self.sheet) > 1 and not self.report:
            raise ConfigError("Several sheets go with --report only: a robot does one at a time.")
        if self.report and self.list:
            raise ConfigError("Give --report or --list, not both.")
