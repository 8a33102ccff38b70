"""Boards: what is printed on them, where their corners lie, and finding those in a picture."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import get_args

import cv2
import numpy as np

from jaxcam.config.calibrate import BoardName, TagFamily
from jaxcam.errors import ConfigError
from jaxcam.robot.calibration.corners import refine_board
from jaxcam.robot.calibration.projection import HALF

MARKERS = (0.5, 0.6, 0.75, 0.8, 0.9)
"""Sides of markers that others print, in squares."""
LEAST_CORNERS = 6
"""Corners of a board that a picture must show."""


def dictionary_of(family: TagFamily) -> cv2.aruco.Dictionary:
    """OpenCV's patterns of a family of tags."""
    april = "X" not in family.upper()
    name = f"DICT_{'APRILTAG_' if april else ''}{family.upper() if not april else family}"
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


@dataclass(frozen=True)
class BoardSeen:
    """Corners of a board in a picture."""

    name: str
    """Of the picture."""
    ids: np.ndarray
    """Which corners, int [n]."""
    pixels: np.ndarray
    """Where they are, float64 [n, 2], ours."""
    markers: dict[int, np.ndarray] = field(default_factory=dict, repr=False)
    """Corners [4, 2] of the markers, by their numbers."""


@dataclass(frozen=True)
class Board:
    """A printed chessboard, with markers in its white squares or without."""

    kind: BoardName
    columns: int
    """Squares from left to right."""
    rows: int
    """Squares from top to bottom."""
    square: float
    """Side of a square (m)."""
    marker: float
    """Side of a marker (m)."""
    family: TagFamily

    def __post_init__(self) -> None:
        if self.kind != "chessboard":
            needed, known = self.columns * self.rows // 2, len(dictionary_of(self.family).bytesList)
            if needed > known:
                raise ConfigError(
                    f"A board of {self.columns}x{self.rows} squares has {needed} markers, the "
                    f"family {self.family} has {known}. Take fewer squares, or a larger family."
                )

    @property
    def words(self) -> str:
        """What it is, for messages."""
        squares = f"{self.columns}x{self.rows} squares of {1000 * self.square:g} mm"
        if self.kind == "chessboard":
            return f"chessboard, {squares}"
        name = "ChArUco of OpenCV before 4.6" if self.kind == "charuco_legacy" else "ChArUco"
        return f"{name}, {squares}, markers of {1000 * self.marker:g} mm, family {self.family}"

    @cached_property
    def points(self) -> np.ndarray:
        """The corners between squares, row by row: x right, y down, z into the board; [n, 3], m."""
        x, y = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        return self.square * np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], -1)

    @cached_property
    def charuco(self) -> cv2.aruco.CharucoBoard:
        """OpenCV's own."""
        size = self.columns, self.rows
        board = cv2.aruco.CharucoBoard(size, self.square, self.marker, dictionary_of(self.family))
        board.setLegacyPattern(self.kind == "charuco_legacy")
        return board

    @cached_property
    def outline(self) -> np.ndarray:
        """Its outer corners, [4, 3] (m)."""
        ends = [[0, 0], [self.columns, 0], [self.columns, self.rows], [0, self.rows]]
        return np.c_[self.square * np.array(ends), np.zeros(4)]

    @cached_property
    def detector(self) -> cv2.aruco.CharucoDetector:
        """OpenCV's, of this board."""
        tags = cv2.aruco.DetectorParameters()
        tags.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        return cv2.aruco.CharucoDetector(self.charuco, cv2.aruco.CharucoParameters(), tags)

    def drawn(self, pixels: int) -> np.ndarray:
        """The board without a margin, uint8 [rows * pixels, columns * pixels].

        Args:
            pixels: Of a square's side.
        """
        if self.kind != "chessboard":
            return self.charuco.generateImage((self.columns * pixels, self.rows * pixels))
        white = np.indices((self.rows, self.columns)).sum(0) % 2
        return np.kron(255 * white, np.ones((pixels, pixels))).astype(np.uint8)

    def find(self, grey: np.ndarray, name: str = "") -> BoardSeen | None:
        """The board's corners in a picture; None where too few can be seen.

        Args:
            grey: Uint8 [H, W].
            name: Of the picture.
        """
        if self.kind == "chessboard":
            return self._find_plain(grey, name)
        corners, ids, tags, numbers = self.detector.detectBoard(grey)
        if ids is None or len(ids) < LEAST_CORNERS:
            return None
        pixels = np.reshape(corners, (-1, 2)).astype(float) + HALF
        order = np.ravel(ids).astype(int)
        markers = {
            int(n): np.reshape(tag, (4, 2)).astype(float) + HALF
            for tag, n in zip(tags, np.ravel(numbers), strict=True)
        }
        pixels = refine_board(grey, self.points[order, :2], pixels - HALF, self._clear) + HALF
        there = BoardSeen(name, order, pixels, markers)
        rank = np.linalg.matrix_rank(np.c_[self.points[order, :2], np.ones(len(order))], tol=1e-9)
        return there if rank == 3 else None  # corners on one line say nothing

    def _find_plain(self, grey: np.ndarray, name: str) -> BoardSeen | None:
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
        size = self.columns - 1, self.rows - 1
        whole, corners = cv2.findChessboardCornersSB(grey, size, flags=flags)
        if not whole:
            return None
        pixels = np.reshape(corners, (-1, 2)).astype(float)
        pixels = refine_board(grey, self.points[:, :2], pixels, self._clear)
        return BoardSeen(name, np.arange(len(pixels)), pixels + HALF)

    @property
    def _clear(self) -> np.ndarray:
        """From a corner, the nearest things that are not its four squares, [4, 2] (m)."""
        if self.kind == "chessboard":
            return self.square * np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]])
        return (self.square - self.marker) / 2 * np.array([[1.0, 1], [1, -1], [-1, 1], [-1, -1]])


def why_not(grey: np.ndarray, board: Board) -> str:
    """Why a board is not in a picture, as far as one can say; empty if nothing else is there.

    Args:
        grey: Uint8 [H, W].
        board: The one that was looked for.
    """
    if board.find(np.ascontiguousarray(grey[:, ::-1])):
        return "it is there mirrored: the pictures are flipped left to right. Take them unflipped"
    numbers = [tag for tag, _ in tags_in(grey, board.family)]
    if board.kind == "chessboard":
        return "it has markers: --board charuco" if len(numbers) >= 3 else ""
    for other, flags in _others(board) if len(numbers) >= 3 else ():
        if other.find(grey):
            return f"it is there as {other.words}: {flags}"
    if len(numbers) >= 3:
        last, most = board.columns * board.rows // 2 - 1, max(numbers)
        more = f", up to number {most} where this board ends with {last}" if most > last else ""
        return (
            f"{len(numbers)} markers of the family {board.family} are there{more}, but do not lie "
            f"as on a board of {board.columns}x{board.rows} squares. Count its squares: --columns "
            "from left to right, --rows from top to bottom"
        )
    if other := other_family(grey, board.family):
        return f"markers of the family {other} are there: --family {other}"
    return ""


def _others(board: Board) -> Iterator[tuple[Board, str]]:
    """Boards that somebody may have meant, and the flags that say so."""
    kind = "charuco" if board.kind == "charuco_legacy" else "charuco_legacy"
    yield replace(board, kind=kind), f"--board {kind}"
    if board.columns != board.rows:
        turned = replace(board, columns=board.rows, rows=board.columns)
        yield turned, f"--columns {turned.columns} --rows {turned.rows}. Count its squares"
    for share in MARKERS:
        marker = share * board.square
        yield replace(board, marker=marker), f"--marker-mm {1000 * marker:g} or about that"


def marker_sides(board: Board, views: Sequence[BoardSeen]) -> float:
    """Side of the markers (m), as large as they look between corners; NaN where none is seen."""
    sides = []
    for view in views:
        points = board.points[view.ids, :2]
        plane = cv2.findHomography(view.pixels, points)[0]
        if plane is None or not view.markers:
            continue
        flat = [cv2.perspectiveTransform(tag[None], plane)[0] for tag in view.markers.values()]
        sides += [np.linalg.norm(np.roll(tag, -1, 0) - tag, axis=-1).mean() for tag in flat]
    return float(np.median(sides)) if sides else float("nan")


def tags_in(grey: np.ndarray, family: TagFamily) -> Iterator[tuple[int, np.ndarray]]:
    """Tags in a picture: their numbers, and corners [4, 2] from the upper left one clockwise.

    Args:
        grey: Uint8 [H, W].
        family: Theirs.
    """
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(dictionary_of(family), settings)
    corners, numbers, _ = detector.detectMarkers(grey)
    if numbers is not None:
        for tag, number in zip(corners, np.ravel(numbers), strict=True):
            yield int(number), np.reshape(tag, (4, 2)).astype(float) + HALF


def other_family(grey: np.ndarray, family: TagFamily) -> TagFamily | None:
    """The family of which two tags, or most, are in a picture that has none of the one asked for.

    Args:
        grey: Uint8 [H, W].
        family: The one asked for.
    """
    best, most = None, 0
    for other in get_args(TagFamily):
        count = len(list(tags_in(grey, other))) if other != family else 0
        if count > most:
            best, most = other, count
    return best
