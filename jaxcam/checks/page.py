"""A check's results, and their page: one HTML file with everything inside."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.figure import Figure

from jaxcam.checks.findings import Finding, named
from jaxcam.data.demos import Demos
from jaxcam.files.png import write_png
from jaxcam.files.whole import write_atomically
from jaxcam.reports.camera_figures import camera_places
from jaxcam.reports.html import embedded, render
from jaxcam.reports.style import BLUE, GREY, save, side_by_side, styled
from jaxcam.sim.task import Task


@dataclass(frozen=True)
class Report:
    """The results of a check."""

    title: str
    subtitle: str
    findings: Sequence[Finding]
    numbers: Sequence[Sequence[str]] = ()
    """Quantity, least, middle, largest."""
    figures: dict[str, Figure] = field(default_factory=dict)
    """By what they show."""
    overlays: np.ndarray | None = None
    """Sheet of pictures, uint8 RGB."""
    caption: str = (
        "What cameras see, with the axes of grip and table (x red, y green, z blue) and the way of "
        "the grip (yellow) drawn where the cameras' numbers have them."
    )
    """What it shows."""


def write_page(report: Report, path: Path) -> Path:
    """Writes a report as one HTML file that loads nothing, and its overlays as PNG beside it."""
    overlays = []
    with TemporaryDirectory() as folder:
        figures = [
            embedded(save(figure, Path(folder) / f"{i}.png"), caption, wide=True)
            for i, (caption, figure) in enumerate(report.figures.items())
        ]
        if report.overlays is not None:
            file = write_png(Path(folder) / "overlays.png", report.overlays)
            overlays = [embedded(file, report.caption, wide=True)]
    content = render(
        "check.html",
        report.title,
        report.subtitle,
        bad=[_in_words(f) for f in report.findings if f.mark == "bad"],
        notes=[_in_words(f) for f in report.findings if f.mark == "note"],
        findings=[(f.mark, named(f), f.got) for f in report.findings],
        overlays=overlays,
        figures=figures,
        numbers=report.numbers,
    )
    write_atomically(path, content)  # first: by it one knows whose picture is beside it
    if report.overlays is not None:
        write_png(path.with_suffix(".png"), report.overlays)
    return path


def draw_figures(demos: Demos, task: Task) -> dict[str, Figure]:
    """Figures of a dataset by what they show."""
    used = np.unique(np.concatenate([d.cameras for d in demos.train]))
    held = np.unique(np.concatenate([d.cameras for d in demos.valid] or [np.empty(0, int)]))
    poses = demos.header.world_from_camera
    return {
        "Lengths of the demonstrations, and the ways of the grip from above.": _ways(demos),
        "Cameras of the training demonstrations and of the validation ones (held out).": (
            camera_places(poses[used], poses[held], task.cameras.centre)
        ),
    }


@styled
def _ways(demos: Demos) -> Figure:
    demos_drawn = demos.episodes
    figure, (lengths, above) = side_by_side((8.2, 3.6), columns=2)
    lengths.hist([d.length for d in demos_drawn], bins=24, color=BLUE)
    lengths.set(xlabel="control steps", ylabel="demonstrations", title="Lengths")
    for demo in demos_drawn:
        above.plot(demo.eef_pos[:, 0], demo.eef_pos[:, 1], color=BLUE, linewidth=0.6, alpha=0.3)
    starts = np.stack([d.eef_pos[0, :2] for d in demos_drawn])
    above.plot(*starts.T, "o", color=GREY, markersize=3, label="start")
    above.set_aspect("equal")
    above.set(xlabel="x (m)", ylabel="y (m)", title="Ways of the grip")
    above.legend()
    return figure


def _in_words(finding: Finding) -> str:
    expected = f" (expected: {finding.expected})" if finding.expected else ""
    return f"{named(finding)}: {finding.got}{expected}. {finding.fix}"
