"""Whether the pictures beside a dataset show what its states and cameras say."""

import re
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from jaxcam.checks.findings import Finding, some
from jaxcam.checks.overlays import PIXELS, Moment, chosen, draw, draw_over, moments, sheet
from jaxcam.data.demos import Demos
from jaxcam.data.pictures import Frames, is_blank, open_frames
from jaxcam.errors import JaxcamError
from jaxcam.rays import spherical
from jaxcam.sim import make_painter, painter_of
from jaxcam.sim.task import Task
from jaxcam.sim.world import World

ALIKE = 2.0
"""Mean difference of two pictures, in levels of 255, up to which they are the same."""
SCANNED = 512
"""Pictures of a cache that are looked at for blank ones."""

TURNS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "red and blue are swapped (BGR)": lambda x: x[..., ::-1],
    "the bottom row is first": lambda x: x[:, ::-1],
    "left and right are swapped": lambda x: x[:, :, ::-1],
    "they are turned upside down": lambda x: x[:, ::-1, ::-1],
    "they are turned by 90°": lambda x: np.rot90(x, 1, (1, 2)),
    "they are turned by -90°": lambda x: np.rot90(x, -1, (1, 2)),
}
"""What may have been done to pictures, and how it is done to ours."""


def check_caches(demos: Demos, task: Task, scene: World, count: int) -> Iterator[Finding]:
    """Compares every frame cache of the dataset with pictures drawn anew, and looks for blank ones.

    Args:
        demos: the dataset.
        task: of the demonstrations.
        scene: of the demonstrations; it can be drawn here.
        count: pictures that are drawn anew.
    """
    folder, stem = demos.path.parent / "frames", demos.path.stem
    pattern = re.compile(re.escape(stem) + r"-([0-9a-f]{16})-(\d+)px-(.+)\.(?:npy|part)")
    matches = [m for p in sorted(folder.glob("*")) if (m := pattern.fullmatch(p.name))]
    if not matches:
        yield Finding("pictures", "good", "none are cached; training draws them")
    for match in matches:
        path, (fingerprint, side, look) = folder / match.string, match.groups()
        what = f"pictures, {side} px"
        if fingerprint != demos.fingerprint or look != painter_of(scene).look():
            other = "of other content"
            if fingerprint == demos.fingerprint:
                other = f"by another renderer, {look}"
            size = path.stat().st_blocks * 512 / 1e6
            yield Finding(
                what,
                "note",
                f"drawn {other}: not used",
                where=path.name,
                fix=f"Delete it to have {size:.0f} MB back.",
            )
            continue
        try:
            frames = open_frames(path, demos, int(side))
        except JaxcamError as error:
            yield Finding(what, "bad", str(error), where=path.name)
            continue
        if not frames.drawn.any():
            yield Finding(what, "note", "none drawn yet", where=path.name)
            continue
        yield _blank(what, path, frames)
        yield _compared(what, path, frames, demos, task, scene, count)


def draw_overlays(demos: Demos, task: Task, scene: World, count: int) -> np.ndarray:
    """Demonstrations as their cameras see them, the axes of grip and table drawn in, as a sheet.

    Args:
        demos: the dataset.
        task: of the demonstrations.
        scene: of the demonstrations; it can be drawn here.
        count: demonstrations that are shown.
    """
    every, shown = demos.train + demos.valid, moments(demos, count)
    azimuth, elevation, _ = spherical(demos.header.world_from_camera, np.array(task.cameras.centre))
    pictures = draw(demos, shown, make_painter(scene, PIXELS, varied=task.varied)).copy()
    captions = []
    for picture, moment in zip(pictures, shown, strict=True):
        draw_over(picture, demos, moment, scene)
        c = int(every[moment.row].cameras[moment.camera])
        angles = f"az {np.rad2deg(azimuth[c]):+.0f} el {np.rad2deg(elevation[c]):.0f}"
        captions.append(f"demo_{moment.row}  step {moment.t}  camera {c}  {angles}")
    return sheet(list(pictures), captions)


def _blank(what: str, path: Path, frames: Frames) -> Finding:
    """Whether pictures are of one colour, or demonstrations stand still."""
    first, cameras = frames.layout.first, frames.layout.cameras
    rows = _some_drawn(frames, SCANNED)
    blank = [int(row) for row in rows if is_blank(frames.pictures[row])]
    frozen = [
        i
        for i, (a, b) in enumerate(pairwise(first))
        if b - a > cameras[i]
        and frames.drawn[[a, b - cameras[i]]].all()
        and np.array_equal(frames.pictures[a], frames.pictures[b - cameras[i]])
    ]
    if not blank and not frozen:
        total, drawn = len(frames.drawn), frames.drawn.sum()
        got = f"{total} frames" if drawn == total else f"{drawn} of {total} frames are drawn"
        return Finding(what, "good", f"{got}; of {len(rows)} looked at none is blank")
    where = some([f"frame {row}" for row in blank] + [f"demo_{i}" for i in frozen])
    got = f"{len(blank)} of {len(rows)} frames are blank; {len(frozen)} demonstrations stand still"
    return Finding(
        what,
        "bad",
        got,
        "pictures of what moves",
        where,
        f"A renderer failed. Delete {path}; it is drawn anew.",
    )


def _compared(
    what: str, path: Path, frames: Frames, demos: Demos, task: Task, scene: World, count: int
) -> Finding:
    rows = _some_drawn(frames, count)
    shown = list(map(Moment, *(part.tolist() for part in frames.layout.where(rows))))
    ours = draw(demos, shown, make_painter(scene, frames.pictures.shape[1], varied=task.varied))
    theirs = frames.pictures[rows]
    apart = _apart(ours, theirs)
    if apart.max() <= ALIKE:
        return Finding(what, "good", f"{len(ours)} drawn anew are the same")
    causes = [words for words, turn in TURNS.items() if _apart(turn(ours), theirs).max() <= ALIKE]
    cause = f"Likely cause: {causes[0]}. " if causes else ""
    where = some([f"demo_{m.row}" for m, a in zip(shown, apart, strict=True) if a > ALIKE])
    got = f"{(apart > ALIKE).sum()} of {len(ours)} differ from states and cameras"
    return Finding(
        what,
        "bad",
        got,
        f"a mean difference of at most {ALIKE:g} levels",
        where,
        f"{cause}Delete {path}; it is drawn anew.",
    )


def _some_drawn(frames: Frames, count: int) -> np.ndarray:
    """Numbers of frames that are drawn, evenly spread."""
    drawn = np.flatnonzero(frames.drawn)
    return drawn[chosen(len(drawn), count)]


def _apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Mean difference of each picture from its counterpart, in levels."""
    return np.abs(a.astype(float) - b).mean((1, 2, 3))
