"""Boards, and why one is not in a picture."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from jaxcam.config.calibrate import TagFamily
from jaxcam.config.names import names_of
from jaxcam.errors import ConfigError
from jaxcam.robot.calibration.boards import (
    Board,
    dictionary_of,
    marker_sides,
    other_family,
    tags_in,
    why_not,
)

SQUARE = 36
BOARD = Board("charuco", 7, 5, 0.03, 0.021, "4x4_50")
PLAIN = Board("chessboard", 7, 5, 0.03, 0.021, "4x4_50")
EVEN = Board("charuco", 7, 6, 0.03, 0.021, "4x4_50")


def shown(board):
    """The board on a grey wall, as large as it is."""
    return np.pad(np.pad(board.drawn(SQUARE), SQUARE, constant_values=255), 30, constant_values=120)


@pytest.mark.parametrize("board", [BOARD, PLAIN], ids=["charuco", "chessboard"])
def test_corners_are_where_they_were_drawn(board):
    view = board.find(shown(board), "a")
    assert len(view.ids) == 24
    at = SQUARE + 30 + SQUARE * board.points[view.ids, :2] / board.square
    if board is PLAIN and np.abs(view.pixels - at).max() > 1:
        at = at[::-1]  # half a turn is the same
    np.testing.assert_allclose(view.pixels, at, atol=0.3)


def test_a_part_of_the_board_is_enough_but_not_a_line_of_it():
    picture = shown(BOARD)
    assert len(BOARD.find(picture[:, :210], "a").ids) < 24
    assert BOARD.find(picture[:120], "a") is None
    assert BOARD.find(np.full((200, 200), 100, np.uint8)) is None


@pytest.mark.parametrize(
    ("there", "asked", "why"),
    [
        (lambda: shown(BOARD)[:, ::-1], BOARD, "mirrored"),
        (lambda: shown(BOARD), Board("charuco", 5, 7, 0.03, 0.021, "4x4_50"), "Count its squares"),
        (lambda: shown(BOARD), Board("charuco", 7, 5, 0.03, 0.021, "6x6_50"), "--family 4x4_50"),
        (lambda: shown(BOARD) * 0, BOARD, "^$"),
        (lambda: shown(EVEN), replace(EVEN, kind="charuco_legacy"), "--board charuco$|charuco[.]"),
        (lambda: shown(replace(EVEN, kind="charuco_legacy")), EVEN, "--board charuco_legacy"),
        (lambda: shown(BOARD), replace(PLAIN, columns=9, rows=8), "it has markers"),
    ],
)  # fmt: skip
def test_why_a_board_is_not_there(there, asked, why):
    picture = np.ascontiguousarray(there())
    assert asked.find(picture) is None
    assert re.search(why, why_not(picture, asked))


@pytest.mark.parametrize("family", names_of(TagFamily))
def test_families_are_opencvs(family):
    ink = cv2.aruco.generateImageMarker(dictionary_of(family), 7, 120)
    picture = np.pad(np.pad(ink, 30, constant_values=255), 20, constant_values=120)
    ((number, corners),) = tags_in(picture, family)
    assert number == 7
    np.testing.assert_allclose(corners, np.array([[0, 0], [120, 0], [120, 120], [0, 120]]) + 50,
                               atol=0.8)  # fmt: skip


def test_another_family_is_named():
    ink = cv2.aruco.generateImageMarker(dictionary_of("36h11"), 7, 120)
    picture = np.pad(ink, 40, constant_values=255)
    assert other_family(picture, "25h9") == "36h11"
    assert other_family(np.full((50, 50), 9, np.uint8), "25h9") is None


def test_a_board_with_more_markers_than_the_family_has():
    with pytest.raises(ConfigError, match=r"60 markers.*has 50"):
        Board("charuco", 12, 10, 0.03, 0.021, "4x4_50")


def test_markers_of_another_size_than_was_said():
    printed = replace(BOARD, marker=0.018)
    for asked in (printed, BOARD):
        view = asked.find(shown(printed))
        if view is None:
            assert "--marker-mm 18" in why_not(shown(printed), asked)
        else:
            assert marker_sides(asked, [view]) == pytest.approx(0.018, rel=0.03)
    assert np.isnan(marker_sides(PLAIN, [PLAIN.find(shown(PLAIN))]))
