"""The PDF of a board has its true size."""

import re
import zlib

import pytest

from jaxcam.errors import ConfigError
from jaxcam.robot.calibration.boards import Board
from jaxcam.robot.calibration.lens.printing import print_board

POINT = 25.4 / 72
"""Millimetres."""


def drawn(path):
    """Of a PDF: the sheet, and the image's width and height, in mm."""
    content = path.read_bytes()
    sheet = [
        float(x) * POINT for x in re.search(rb"/MediaBox \[ 0 0 (\S+) (\S+) \]", content).groups()
    ]
    for stream in re.findall(rb"stream\r?\n(.*?)endstream", content, re.DOTALL):
        try:
            text = zlib.decompress(stream)
        except zlib.error:
            continue
        if place := re.search(rb"cm\s+(\S+)\s+0\s+0\s+(\S+)\s+0\s+\S+\s+cm\s+/I1", text):
            return sheet, [abs(float(x)) * POINT for x in place.groups()]
    raise AssertionError("no image")


@pytest.mark.parametrize(
    ("columns", "rows", "square", "sheet", "size"),
    [(11, 8, 0.023, "A4", (297, 210)), (11, 8, 0.03, "A3", (420, 297))],
)
def test_true_size(tmp_path, columns, rows, square, sheet, size):
    board = Board("charuco", columns, rows, square, 0.7 * square, "4x4_50")
    path = tmp_path / "board.pdf"
    assert print_board(board, path) == sheet
    there, image = drawn(path)
    assert there == pytest.approx(size, abs=0.01)
    assert image == pytest.approx((1000 * columns * square, 1000 * rows * square), abs=0.01)


def test_what_cannot_be_printed(tmp_path):
    board = Board("charuco", 10, 8, 0.3, 0.2, "4x4_50")
    with pytest.raises(ConfigError, match="fits on no sheet"):
        print_board(board, tmp_path / "board.pdf")
    with pytest.raises(ConfigError, match=r"ends in \.pdf"):
        print_board(board, tmp_path / "board.png")
    assert not list(tmp_path.iterdir())
