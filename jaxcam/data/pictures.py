"""The pictures of a dataset, rendered once per (dataset, cameras, resolution, renderer).

A cache is one uint8 array on disk, `[pictures, H, W, 3]`, read through a memory map. It is written
as `<name>.part` beside a note of which are drawn, so an interrupted rendering goes on. A run that
sees few of them has only those drawn: a `.part` may stay one, with holes that take no disk.
"""

import functools
import multiprocessing
import os
import shutil
import signal
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console

from jaxcam.console.progress import progress
from jaxcam.data.cameras import require_possible
from jaxcam.data.demos import Demo, Demos, Header
from jaxcam.data.samples import Layout
from jaxcam.errors import DatasetError, SimError
from jaxcam.files.locks import exclusive
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.sim import make_painter, make_task, painter_of
from jaxcam.sim.painter import Painter
from jaxcam.sim.types import View
from jaxcam.sim.world import World

PICTURES_AT_ONCE = 512
"""Pictures that are drawn and kept together."""
GROUPS_PER_WORKER = 8
"""Groups of pictures below which another process is not worth its start."""


@dataclass(frozen=True)
class Pictures:
    """Pictures of some demonstrations; `layout` says which is where."""

    rgb: np.ndarray = field(repr=False)
    """uint8 [pictures, H, W, 3], top row first."""
    layout: Layout = field(repr=False)
    drawn: np.ndarray = field(repr=False)
    """Which of them are drawn, bool [pictures]; the others are black."""


def load_pictures(
    demos: Demos,
    resolution: int,
    console: Console | None = None,
    wanted: np.ndarray | None = None,
) -> Pictures:
    """Renders what is missing of a dataset's pictures and opens them.

    Args:
        demos: The dataset; training demonstrations come first, validation ones after.
        resolution: Side of the pictures (pixels).
        console: For progress; silent when None.
        wanted: Those that will be looked at, bool [pictures]; the others may stay empty. All when
            None.

    Raises:
        CameraError: If the cameras cannot have seen the demonstrations.
        DatasetError: If the disk has no room for them, or they are damaged.
        SimError: If pictures come out blank.
    """
    require_possible(demos)
    look = painter_of(_scene(demos.header)).look()
    name = f"{demos.path.stem}-{demos.fingerprint}-{resolution}px-{look}.npy"
    path = demos.path.parent / "frames" / name
    if path.exists():
        return open_pictures(path, demos, resolution)
    with exclusive(path, console):
        if not path.exists():
            path = _render(path, demos, resolution, console, wanted)
        return open_pictures(path, demos, resolution)


def open_pictures(path: Path, demos: Demos, resolution: int) -> Pictures:
    """Opens a cache.

    Args:
        path: Of the cache.
        demos: The dataset whose pictures it holds.
        resolution: Side of the pictures (pixels).

    Raises:
        DatasetError: If it is not what was written.
    """
    layout = Layout.of(demos)
    shape = (layout.total, resolution, resolution, 3)
    try:
        rgb = np.load(path, mmap_mode="r")
        content = f"{rgb.dtype} {list(rgb.shape)}"
    except (OSError, ValueError, EOFError) as error:
        rgb, content = None, f"{path.stat().st_size} bytes that cannot be read ({error})"
    if rgb is None or rgb.shape != shape or rgb.dtype != np.uint8:
        raise DatasetError(
            f"{path}: the pictures should be uint8 {list(shape)}, but are {content}. Delete the "
            "file; they are drawn anew."
        )
    return Pictures(rgb, layout, _drawn(path, layout.total))


def _drawn(path: Path, total: int) -> np.ndarray:
    """Which pictures of a cache are drawn, bool [total]."""
    if path.suffix != ".part":
        return np.ones(total, bool)
    flags = path.with_suffix(".drawn")
    drawn = np.fromfile(flags, bool) if path.exists() and flags.exists() else np.zeros(0, bool)
    return drawn if len(drawn) == total else np.zeros(total, bool)


def _render(
    path: Path,
    demos: Demos,
    resolution: int,
    console: Console | None,
    wanted: np.ndarray | None,
) -> Path:
    """Draws the wanted pictures that are missing; returns where they are."""
    layout = Layout.of(demos)
    part = _Part(path, (layout.total, resolution, resolution, 3))
    wanted = np.ones(layout.total, bool) if wanted is None else wanted
    missing = np.flatnonzero(wanted & ~part.drawn)
    if len(missing):
        part.make_room(len(missing))
        episodes = demos.episodes
        groups = [
            rows[i : i + PICTURES_AT_ONCE]
            for rows in np.split(missing, np.flatnonzero(np.diff(layout.owner(missing))) + 1)
            for i in range(0, len(rows), PICTURES_AT_ONCE)
        ]

        def view(rows: np.ndarray) -> View:
            d = layout.owner(rows[0])
            return views_of(episodes[d], demos, resolution, rows - layout.first[d])

        total = int(wanted.sum())
        drawn = _draw(demos.header, resolution, map(view, groups), len(groups))
        with progress(console, "rendering", total, done=total - len(missing)) as advance:
            for rows, pictures in zip(groups, drawn, strict=True):
                part.write(rows, pictures)
                advance(len(rows))
    return part.finish()


def _draw(
    header: Header, resolution: int, views: Iterable[View], count: int
) -> Iterator[np.ndarray]:
    """Pictures of each view in order; by one process a core where one draws with one thread."""
    workers = min(os.cpu_count() or 1, count // GROUPS_PER_WORKER)
    if workers < 2 or painter_of(_scene(header)).uses_all_cores():
        draw = functools.partial(_draw_view, header.task, header.scene, resolution)
        yield from map(draw, views)
        return
    # Not forked: JAX has threads. The pool asks for the main module's file when it spawns.
    with ProcessPoolExecutor(
        workers,
        multiprocessing.get_context("spawn"),
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_IGN),  # Ctrl-C is this process's to answer
    ) as pool:
        work = deque[Future[np.ndarray]]()
        try:
            for view in views:
                work.append(pool.submit(_draw_view, header.task, header.scene, resolution, view))
                if len(work) > 2 * workers:
                    yield work.popleft().result()
            while work:
                yield work.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)


@functools.cache
def _renderer(task_name: str, scene_name: str, resolution: int) -> Painter:
    task = make_task(task_name)
    return make_painter(task.scene(scene_name), resolution, varied=task.varied)


def is_blank(picture: np.ndarray) -> bool:
    """Whether a picture [H, W, 3] is of one colour: a fault of its renderer."""
    return not np.ptp(picture, (0, 1)).any()


def _draw_view(task: str, scene: str, resolution: int, view: View) -> np.ndarray:
    """Pictures of a view; if some are blank, by another renderer, once."""
    for _ in range(2):
        pictures = _renderer(task, scene, resolution).rgb(view)
        blank = sum(map(is_blank, pictures))
        if not blank:
            return pictures
        _renderer.cache_clear()
    raise SimError(
        f"{blank} of {len(pictures)} pictures of a demonstration of {task}, {scene} are of one "
        "colour, and again with another renderer. Free the graphics card's memory, or look where "
        "the cameras are: python -m jaxcam.check DATASET. What was drawn is kept."
    )


def _scene(header: Header) -> World:
    return make_task(header.task).scene(header.scene)


def views_of(demo: Demo, demos: Demos, resolution: int, which: np.ndarray | None = None) -> View:
    """What a demonstration's pictures show, by time, then camera; of all, or of those named."""
    cameras = len(demo.cameras)
    which = np.arange(demo.length * cameras) if which is None else which
    t, camera = np.divmod(which, cameras)
    count = len(which)
    K = intrinsics(demos.header.fovy_deg, resolution)
    return View(
        qpos=demo.qpos[t],
        geom_size=np.broadcast_to(demo.geom_size, (count, *demo.geom_size.shape)),
        fixtures=np.broadcast_to(demo.fixtures, (count, *demo.fixtures.shape)),
        K=np.broadcast_to(K, (count, 3, 3)),
        world_from_camera=demos.header.world_from_camera[demo.cameras[camera]],
    )


class _Part:
    """An unfinished cache, and which of its pictures are drawn."""

    def __init__(self, path: Path, shape: tuple[int, ...]) -> None:
        self.path = path
        self.part, self._flags = path.with_suffix(".part"), path.with_suffix(".drawn")
        self._shape, self._size = shape, int(np.prod(shape[1:]))
        self.drawn = _drawn(self.part, shape[0])

    def make_room(self, count: int) -> None:
        """Makes sure that there is space for `count` more pictures, and begins the cache.

        Raises:
            DatasetError: If the disk has too little.
        """
        need, free = count * self._size, shutil.disk_usage(self.path.parent).free
        if free < need * 1.05:
            raise DatasetError(
                f"{self.path.parent}: the pictures need {need / 1e9:.2g} GB, but {free / 1e9:.2g} "
                "GB are free. Choose another --data-dir or a smaller --resolution."
            )
        if not self.drawn.any():
            np.lib.format.open_memmap(self.part, "w+", np.uint8, self._shape)
            self.drawn.tofile(self._flags)

    def write(self, rows: np.ndarray, pictures: np.ndarray) -> None:
        """Writes pictures of ascending numbers."""
        # Not through a map: where the disk is full that kills the process, this raises.
        try:
            offset = self.part.stat().st_size - len(self.drawn) * self._size
            with open(self.part, "r+b") as file:
                for run in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(rows) > 1) + 1):
                    file.seek(offset + int(rows[run[0]]) * self._size)
                    file.write(np.ascontiguousarray(pictures[run]).data)
            self.drawn[rows] = True
            with open(self._flags, "r+b") as file:
                file.seek(int(rows[0]))
                file.write(self.drawn[rows[0] : rows[-1] + 1].tobytes())
        except OSError as error:
            raise DatasetError(
                f"{self.part}: {error.strerror}. What is rendered is kept; make room and repeat."
            ) from error

    def finish(self) -> Path:
        """Gives a complete cache its name; returns where the pictures are."""
        if not self.drawn.all():
            return self.part
        os.replace(self.part, self.path)
        self._flags.unlink()
        return self.path
