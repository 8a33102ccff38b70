"""Whether the pictures beside a dataset show what its states and cameras say."""

import re
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from jaxcam.checks.findings import Finding, bad, good, note
from jaxcam.checks.overlays import PIXELS, Moment, chosen, draw, draw_over, moments, sheet
from jaxcam.console.words import some
from jaxcam.data.caches import is_black
from jaxcam.data.demos import Demos
from jaxcam.data.pictures import Pictures, cache_of
from jaxcam.data.samples import Layout
from jaxcam.errors import JaxcamError
from jaxcam.rays import spherical
from jaxcam.sim import make_painter, painter_of
from jaxcam.sim.painter import Painter
from jaxcam.sim.task import Task
from jaxcam.sim.world import World

ALIKE = 2.0
"""Mean difference of two pictures, in levels of 255, up to which they are the same."""
SCANNED = 512
"""Pictures of a cache that are looked at for black ones."""

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
    """Compares cached pictures of the dataset with pictures drawn anew, and looks for black ones.

    Args:
        demos: The dataset.
        task: Of the demonstrations.
        scene: Of the demonstrations; it can be drawn here.
        count: Pictures that are drawn anew.
    """
    folder, stem = demos.path.parent / "frames", demos.path.stem
    pattern = re.compile(re.escape(stem) + r"-([0-9a-f]{16})-(\d+)px-(.+)\.(?:npy|part)")
    matches = [m for p in sorted(folder.glob("*")) if (m := pattern.fullmatch(p.name))]
    if not matches:
        yield good("pictures", got="none are cached; training draws them")
    for match in matches:
        path, (fingerprint, side, look) = folder / match.string, match.groups()
        what = f"pictures, {side} px"
        if fingerprint != demos.fingerprint or look != painter_of(scene).look():
            other = "of other content"
            if fingerprint == demos.fingerprint:
                other = f"by another renderer, {look}"
            size = path.stat().st_blocks * 512 / 1e6
            yield note(
                what,
                got=f"drawn {other}: not used",
                where=path.name,
                fix=f"Delete it to have {size:.0f} MB back.",
            )
            continue
        try:
            cache = cache_of(path.with_suffix(".npy"), demos, int(side))
        except JaxcamError as error:
            yield bad(what, got=str(error), where=path.name)
            continue
        if cache.rgb is None:
            yield bad(
                what, got="cannot be read", where=path.name, fix="Delete it; it is drawn anew."
            )
            continue
        if not cache.drawn.any():
            yield note(what, got="none drawn yet", where=path.name)
            continue
        pictures = Pictures(cache.rgb, Layout.of(demos), cache.drawn)
        if cache.has_sums and (damaged := np.flatnonzero(cache.damaged())).size:
            yield _damaged(what, path, damaged, pictures)
        else:
            yield _black(what, path, pictures, has_sums=cache.has_sums)
        yield _compared(what, path, pictures, demos, task, scene, count)


def draw_overlays(demos: Demos, task: Task, scene: World, count: int) -> np.ndarray:
    """Demonstrations as their cameras see them, the axes of grip and table drawn in, as a sheet.

    Args:
        demos: The dataset.
        task: Of the demonstrations.
        scene: Of the demonstrations; it can be drawn here.
        count: Demonstrations that are shown.
    """
    episodes, shown = demos.episodes, moments(demos, count)
    azimuth, elevation, _ = spherical(demos.header.world_from_camera, np.array(task.cameras.centre))
    pictures = draw(demos, shown, _painter(demos, task, scene, PIXELS)).copy()
    captions = []
    for picture, moment in zip(pictures, shown, strict=True):
        draw_over(picture, demos, moment, scene)
        c = int(episodes[moment.row].cameras[moment.camera])
        angles = f"az {np.rad2deg(azimuth[c]):+.0f} el {np.rad2deg(elevation[c]):.0f}"
        captions.append(f"demo_{moment.row}  step {moment.t}  camera {c}  {angles}")
    return sheet(list(pictures), captions)


def _damaged(what: str, path: Path, damaged: np.ndarray, cache: Pictures) -> Finding:
    """That pictures are not what was drawn."""
    demos = sorted({int(d) for d in cache.layout.owner(damaged)})
    return bad(
        what,
        got=f"{len(damaged)} of {cache.drawn.sum()} are not what was drawn: other checksums",
        expected="what was drawn",
        where=f"{path.name}: {some([f'demo_{d}' for d in demos])}",
        fix="Training draws them again.",
    )


def _black(what: str, path: Path, cache: Pictures, *, has_sums: bool) -> Finding:
    """Whether pictures are black, or demonstrations stand still."""
    first, cameras = cache.layout.first, cache.layout.cameras
    rows = _some_drawn(cache, SCANNED)
    black = [int(row) for row in rows if is_black(cache.rgb[row])]
    frozen = [
        i
        for i, (a, b) in enumerate(pairwise(first))
        if b - a > cameras[i]
        and cache.drawn[[a, b - cameras[i]]].all()
        and np.array_equal(cache.rgb[a], cache.rgb[b - cameras[i]])
    ]
    if not black and not frozen:
        total, drawn = len(cache.drawn), cache.drawn.sum()
        got = f"{total} pictures" if drawn == total else f"{drawn} of {total} pictures are drawn"
        sums = "all are what was drawn" if has_sums else "they get checksums when they are used"
        return good(what, got=f"{got}; {sums}; of {len(rows)} looked at none is black")
    where = some([f"picture {row}" for row in black] + [f"demo_{i}" for i in frozen])
    got = (
        f"{len(black)} of {len(rows)} pictures are black; {len(frozen)} demonstrations stand still"
    )
    return bad(
        what,
        got=got,
        expected="pictures of what moves",
        where=where,
        fix=f"A renderer failed. Delete {path}; it is drawn anew.",
    )


def _painter(demos: Demos, task: Task, scene: World, side: int) -> Painter:
    """What draws a dataset's cameras, in square pictures."""
    lenses = demos.header.distortion is not None
    return make_painter(scene, side, varied=task.varied, lenses=lenses)


def _compared(
    what: str, path: Path, cache: Pictures, demos: Demos, task: Task, scene: World, count: int
) -> Finding:
    """Whether pictures are what is drawn here of their states and cameras."""
    rows = _some_drawn(cache, count)
    shown = list(map(Moment, *(part.tolist() for part in cache.layout.where(rows))))
    ours = draw(demos, shown, _painter(demos, task, scene, cache.rgb.shape[1]))
    theirs = cache.rgb[rows]
    apart = _apart(ours, theirs)
    if apart.max() <= ALIKE:
        return good(what, got=f"{len(ours)} drawn anew are the same")
    causes = [words for words, turn in TURNS.items() if _apart(turn(ours), theirs).max() <= ALIKE]
    cause = f"Likely cause: {causes[0]}. " if causes else ""
    where = some([f"demo_{m.row}" for m, a in zip(shown, apart, strict=True) if a > ALIKE])
    got = f"{(apart > ALIKE).sum()} of {len(ours)} differ from states and cameras"
    return bad(
        what,
        got=got,
        expected=f"a mean difference of at most {ALIKE:g} levels",
        where=where,
        fix=f"{cause}Delete {path}; it is drawn anew.",
    )


def _some_drawn(cache: Pictures, count: int) -> np.ndarray:
    """Numbers of pictures that are drawn, evenly spread."""
    drawn = np.flatnonzero(cache.drawn)
    return drawn[chosen(len(drawn), count)]


def _apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Mean difference of each picture from its counterpart, in levels."""
    return np.abs(a.astype(float) - b).mean((1, 2, 3))
