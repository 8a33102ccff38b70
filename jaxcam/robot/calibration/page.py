"""The page of a calibration: a sentence on whether it is good enough, and what shows why."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from jaxcam.errors import ConfigError
from jaxcam.files.paths import absolute
from jaxcam.files.png import write_png
from jaxcam.files.whole import check_free, write_atomically
from jaxcam.reports.html import embedded, render
from jaxcam.reports.style import save

SEEN, FITTED, AWAY = (0, 158, 230), (213, 94, 0), (200, 40, 160)
"""Colours in overlays: what was seen, what the calibration says, and what was left out."""
WIDE = 470
"""Pixels of an overlay's side at least, so that crosses can be seen."""
SHOWN = 6
"""Pictures with overlays."""


@dataclass(frozen=True)
class CalibrationPage:
    """What a calibration shows to people."""

    title: str
    subtitle: str
    verdict: str
    """One plain sentence on whether it is good enough."""
    good: bool
    numbers: Sequence[Sequence[str]]
    """Rows of a table."""
    head: Sequence[str] = ("quantity", "value", "standard deviation")
    notes: Sequence[str] = ()
    overlays: dict[str, np.ndarray] = field(default_factory=dict)
    """Pictures by what they show, uint8 RGB."""
    figures: dict[str, Figure] = field(default_factory=dict)
    """By what they show."""


def page_path(out: str, cameras: Path, form: str, view: str) -> Path:
    """Where a page goes, if that may be written.

    Args:
        out: As the user named it; beside the file of calibrations when empty.
        cameras: That file.
        form: Name of the form.
        view: Of the camera, or empty.

    Raises:
        ConfigError: Something else is there.
    """
    name = "".join(c if c.isalnum() or c in "-_" else "-" for c in view)
    path = (
        absolute(out) if out else cameras.with_name("-".join(filter(None, (form, name))) + ".html")
    )
    if path.suffix != ".html":
        raise ConfigError(f"--out {path}: expected a name that ends in .html.")
    check_free(path, (cameras,))
    return path


def show_calibration(page: CalibrationPage, path: Path, console: Console, written: str) -> None:
    """Says what was found, and then writes the page.

    Args:
        page: What was found.
        path: Where the page goes.
        console: Where to say it.
        written: What was written already, and where.
    """
    for line in (page.verdict, *page.notes, written):
        if line:
            console.print(line, soft_wrap=True)
    write_calibration(page, path)
    console.print(f"Page: {path}", soft_wrap=True)


def write_calibration(page: CalibrationPage, path: Path) -> Path:
    """Writes a page, one HTML file that loads nothing."""
    with TemporaryDirectory() as folder:
        figures = [
            embedded(save(figure, Path(folder) / f"{i}.png"), caption, wide=True)
            for i, (caption, figure) in enumerate(page.figures.items())
        ]
        overlays = [
            embedded(write_png(Path(folder) / f"o{i}.png", picture), caption, wide=False)
            for i, (caption, picture) in enumerate(page.overlays.items())
        ]
    content = render(
        "calibration.html",
        page.title,
        page.subtitle,
        verdict=page.verdict,
        good=page.good,
        notes=page.notes,
        head=page.head,
        numbers=page.numbers,
        overlays=overlays,
        figures=figures,
    )
    write_atomically(path, content)
    return path


def overlay(
    rgb: np.ndarray, rings: np.ndarray, fitted: np.ndarray, used: np.ndarray | None = None
) -> np.ndarray:
    """A picture with rings where points were seen and crosses where the calibration has them.

    Args:
        rgb: The picture, uint8 [H, W, 3].
        rings: Pixels [n, 2], ours.
        fitted: Pixels [n, 2].
        used: Which count, bool [n]; the rings of others have another colour.
    """
    scale = max(1, -(-WIDE // rgb.shape[1]))
    size = rgb.shape[1] * scale, rgb.shape[0] * scale
    picture = cv2.resize(rgb, size, interpolation=cv2.INTER_CUBIC)
    used = np.ones(len(rings), bool) if used is None else used

    def at(point: np.ndarray) -> tuple[int, int]:
        x, y = np.rint(np.clip((point * scale - 0.5) * 8, -1e6, 1e6)).astype(int)
        return int(x), int(y)

    for ring, cross, is_used in zip(rings, fitted, used, strict=True):
        cv2.circle(picture, at(ring), 40, SEEN if is_used else AWAY, 1, cv2.LINE_AA, shift=3)
        for step in (np.array([3.0, 3.0]), np.array([3.0, -3.0])):
            ends = at(cross - step / scale), at(cross + step / scale)
            cv2.line(picture, *ends, FITTED, 1, cv2.LINE_AA, shift=3)
    return picture


def spread_out(count: int, most: int = SHOWN) -> list[int]:
    """Numbers of at most so many things, evenly spaced."""
    return sorted({int(i) for i in np.linspace(0, count - 1, min(count, most)).round()})
