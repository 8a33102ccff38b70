"""Boards as PDF files of true size."""

from pathlib import Path

from matplotlib.figure import Figure

from jaxcam.errors import ConfigError
from jaxcam.files.whole import whole
from jaxcam.robot.calibration.boards import Board

INCH = 25.4
MARGIN = 5.0
"""What printers leave white at each edge of a sheet (mm)."""
SHEETS = {"A4": (297, 210), "A3": (420, 297), "A2": (594, 420), "A1": (841, 594), "A0": (1189, 841)}
"""Landscape (mm)."""
BAR = 100.0
"""Length of the line to measure (mm)."""
NOTE = 9.0
"""Height that it takes below the board, with the words beside it (mm)."""
PIXELS = 96
"""Of a square's side; a marker's cells are whole numbers of them."""


def print_board(board: Board, path: Path) -> str:
    """Writes a board as a PDF of true size, on the smallest sheet that it fits on.

    Args:
        board: The board.
        path: Of the PDF.

    Returns:
        The sheet's name.

    Raises:
        ConfigError: It fits on no sheet, or the path is no PDF's.
    """
    if path.suffix.lower() != ".pdf":
        raise ConfigError(f"--print-board {path}: expected a name that ends in .pdf.")
    width, height = (1000 * board.square * n for n in (board.columns, board.rows))
    fits = (
        (name, size)
        for name, size in SHEETS.items()
        if width + 2 * MARGIN <= size[0] and height + NOTE + 2 * MARGIN <= size[1]
    )
    name, sheet = next(fits, ("", (0, 0)))
    if not name:
        raise ConfigError(
            f"A board of {width:.0f} mm x {height:.0f} mm fits on no sheet up to A0. Take fewer or "
            "smaller squares."
        )
    figure = Figure(figsize=(sheet[0] / INCH, sheet[1] / INCH))
    left, bottom = (sheet[0] - width) / 2, (sheet[1] - height - NOTE) / 2 + NOTE
    axes = figure.add_axes(
        (left / sheet[0], bottom / sheet[1], width / sheet[0], height / sheet[1])
    )
    axes.imshow(board.drawn(PIXELS), cmap="gray", vmin=0, vmax=255, interpolation="none",
                aspect="auto", resample=False)  # fmt: skip
    axes.set_axis_off()
    line = figure.add_axes((left / sheet[0], (bottom - NOTE) / sheet[1], width / sheet[0],
                            NOTE / sheet[1]))  # fmt: skip
    line.set(xlim=(0, width), ylim=(0, NOTE))
    line.set_axis_off()
    bar = min(BAR, 10 * (width // 10))
    line.plot([0, bar], [5, 5], color="black", linewidth=0.8, solid_capstyle="butt")
    for x in (0, bar):
        line.plot([x, x], [3.5, 6.5], color="black", linewidth=0.8)
    words = f"This line is {bar:g} mm: measure it. Print at 100 %, do not scale. {board.words}."
    line.text(0, 0, words, fontsize=7, va="bottom")
    with whole(path) as part:
        figure.savefig(part, format="pdf")
    return name
