"""Settings of `jaxcam.calibrate`: a record for each form, and the table of the forms."""

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from jaxcam.config.calibrate_arm import ArmConfig, DriftConfig
from jaxcam.config.fields import check_least, check_most, check_types
from jaxcam.config.flags import default
from jaxcam.errors import ConfigError

BoardName = Literal["charuco", "charuco_legacy", "chessboard"]
"""Boards; `charuco_legacy` is what OpenCV before 4.6 printed, white in the upper left where the
number of rows is even."""
LensKind = Literal["opencv", "fisheye"]
"""Models of a lens that has coefficients."""
TagFamily = Literal[
    "36h11", "36h10", "25h9", "16h5", "4x4_50", "4x4_100", "4x4_250", "5x5_50", "5x5_100",
    "5x5_250", "6x6_50", "6x6_100", "6x6_250",
]  # fmt: skip
"""AprilTag's families by their numbers, and ArUco's by cells and count."""
RotationForm = Literal[
    "by_names", "rotvec", "quaternion_wxyz", "quaternion_xyzw", "euler_xyz", "euler_zyx_intrinsic"
]
"""How the grip's rotation is written; `by_names` is what the numbers' names say."""


MOST_DELAY = 2000
"""Milliseconds that states and pictures may be apart."""


@dataclass(frozen=True)
class LensConfig:
    """Pictures or a video of a printed board: K and the lens of a camera, and how sure they are.

    Print the board first (--print-board board.pdf), glue it on something flat, and show it to the
    camera about 20 times: in the middle and in all corners, tilted to each side.
    """

    pictures: tyro.conf.Positional[
        Annotated[tuple[str, ...], tyro.conf.arg(metavar="PICTURES"), default("none")]
    ] = ()
    """A folder of pictures, pictures, or a video."""
    view: Annotated[str, default("none")] = ""
    """The camera's name, as the dataset calls its view."""
    cameras: str = "cameras.json"
    """File of calibrations that is written, or updated; other views in it stay."""
    print_board: Annotated[str, default("none")] = ""
    """Write the board to this PDF, in true size, and end."""
    board: BoardName = "charuco"
    """A chessboard with markers, which may be seen in part (charuco_legacy if OpenCV before 4.6
    printed it), or a plain one."""
    columns: int = 11
    """Squares of the board from left to right."""
    rows: int = 8
    """Squares from top to bottom."""
    square_mm: float = 23.0
    """Side of a square: measure it on the print."""
    marker_mm: Annotated[float | None, tyro.conf.arg(metavar="FLOAT"), default("0.7 squares")] = (
        None
    )
    """Side of a marker."""
    family: TagFamily = "4x4_50"
    """Family of the markers."""
    lens: LensKind = "opencv"
    """Model of the lens; fisheye from about 120 degrees on."""
    coefficients: int = 5
    """Of the model opencv: 4, 5 or 8."""
    most: int = 40
    """Pictures that are used: those that differ most, if there are more."""
    out: Annotated[str, default("beside the file of calibrations")] = ""
    """HTML page to write."""

    def __post_init__(self) -> None:
        check_types(self)
        check_least(self, 3, "columns rows")
        check_most(self, 50, "columns rows")
        check_least(self, 0, "square_mm marker_mm", or_equal=False)
        check_most(self, 10_000, "square_mm marker_mm most")
        check_least(self, 4, "most")
        if self.coefficients not in (4, 5, 8):
            raise ConfigError(f"coefficients must be 4, 5 or 8, got {self.coefficients}.")
        if self.lens == "fisheye" and self.coefficients != 5:
            raise ConfigError("--coefficients is for --lens opencv: a fisheye has four.")
        _check_marker(self.marker_mm, self.square_mm)
        if self.print_board:
            if self.pictures:
                raise ConfigError("--print-board reads no pictures: print first, then calibrate.")
        elif not self.pictures:
            raise ConfigError(
                "No pictures. Name a folder, pictures or a video of the board, or print one: "
                "--print-board board.pdf."
            )
        else:
            _check_view(self.view)


@dataclass(frozen=True)
class TagsConfig:
    """Tags at known places in the robot's base frame: where each camera stands.

    Of pictures or a video, the pose of one camera; of a recorded dataset, the pose of each view in
    each episode, from the episode's own pictures.
    """

    source: tyro.conf.Positional[
        Annotated[tuple[str, ...], tyro.conf.arg(metavar="PICTURES|DATASET")]
    ]
    """A folder of pictures, pictures, or a video of one camera; or a recorded dataset's folder."""
    tags: str = "tags.json"
    """File that says which tags there are, their size, and where they lie."""
    view: Annotated[str, default("none; all of a dataset")] = ""
    """The camera's name; of a dataset, the only view that is looked at."""
    cameras: str = "cameras.json"
    """File of calibrations that has K (from `calibrate lens`), and gets the poses."""
    most: int = 20
    """Pictures of a camera, or of a view in an episode, that are used, evenly spaced."""
    out: Annotated[str, default("beside the file of calibrations")] = ""
    """HTML page to write."""

    def __post_init__(self) -> None:
        check_types(self)
        check_least(self, 1, "most")
        check_most(self, 10_000, "most")
        if not self.source:
            raise ConfigError("No pictures. Name a folder, pictures, a video, or a dataset.")


@dataclass(frozen=True)
class HandEyeConfig:
    """A tag or board and a camera, one of which the hand carries: where the camera is.

    Also finds where the tag or board is. Fifteen poses are enough, if the hand turns about two
    axes by 30 degrees or more.
    """

    dataset: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="DATASET")]]
    """Folder of a recorded dataset, whose state has the grip's pose."""
    view: Annotated[str, default("none")] = ""
    """The camera's name, as the dataset calls its view."""
    mount: Literal["fixed", "grip"] = "fixed"
    """What carries the camera: it stands and the hand carries the tag, or the hand carries it and
    the tag stands."""
    grip_pose: Annotated[str, default("by its names")] = ""
    """Where the state has the grip's pose, such as observation.state[0:6]: position (m), then
    rotation."""
    rotation: RotationForm = "by_names"
    """How its rotation is written (radians). euler_xyz turns about fixed axes x, y, z."""
    delay_ms: float = 0.0
    """By how many milliseconds states are later than their pictures."""
    target: Literal["tag", "charuco", "charuco_legacy"] = "tag"
    """What is seen: a tag, or a board with markers."""
    family: Annotated[TagFamily | None, tyro.conf.arg(metavar="FAMILY"),
                      default("36h11; 4x4_50 of boards")] = None  # fmt: skip
    """Family of the tag, or of the board's markers."""
    tag: int = 0
    """Number of the tag."""
    size_mm: float = 40.0
    """Side of its black square."""
    columns: int = 11
    """Squares of the board from left to right."""
    rows: int = 8
    """Squares from top to bottom."""
    square_mm: float = 23.0
    """Side of a square: measure it on the print."""
    marker_mm: Annotated[float | None, tyro.conf.arg(metavar="FLOAT"), default("0.7 squares")] = (
        None
    )
    """Side of a marker."""
    cameras: str = "cameras.json"
    """File of calibrations that has K (from `calibrate lens`), and gets the pose."""
    most: int = 60
    """Pictures that are used: those whose grip poses differ most, and in which it is slow."""
    out: Annotated[str, default("beside the file of calibrations")] = ""
    """HTML page to write."""

    def __post_init__(self) -> None:
        check_types(self)
        check_least(self, 0, "size_mm square_mm marker_mm", or_equal=False)
        check_most(self, 10_000, "size_mm square_mm marker_mm most tag")
        check_least(self, 3, "most columns rows")
        check_most(self, 50, "columns rows")
        check_least(self, 0, "tag")
        check_least(self, -MOST_DELAY, "delay_ms")
        check_most(self, MOST_DELAY, "delay_ms")
        _check_marker(self.marker_mm, self.square_mm)
        _check_view(self.view)


@dataclass(frozen=True)
class CalibrateConfig:
    """Find how cameras see, and where they stand: each form writes or updates cameras.json."""

    form: tyro.conf.OmitSubcommandPrefixes[
        tyro.conf.OmitArgPrefixes[
            Annotated[LensConfig, tyro.conf.subcommand("lens")]
            | Annotated[TagsConfig, tyro.conf.subcommand("tags")]
            | Annotated[HandEyeConfig, tyro.conf.subcommand("hand-eye")]
            | Annotated[ArmConfig, tyro.conf.subcommand("arm")]
            | Annotated[DriftConfig, tyro.conf.subcommand("drift")]
        ]
    ]
    """What is done."""


def _check_marker(marker_mm: float | None, square_mm: float) -> None:
    """Refuses markers that are larger than the squares that they are in."""
    if marker_mm is not None and marker_mm >= square_mm:
        raise ConfigError(
            f"A marker ({marker_mm:g} mm) is smaller than its square ({square_mm:g} mm). Was one "
            "taken for the other?"
        )


def _check_view(view: str) -> None:
    if not view:
        raise ConfigError(
            "Which camera? --view is its name in cameras.json, as the dataset calls its view, for "
            "example --view front."
        )
