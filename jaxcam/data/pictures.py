"""The pictures of a dataset, rendered once per (dataset, cameras, resolution, renderer).

A cache is one uint8 array on disk, `[pictures, H, W, 3]`, read through a memory map. It is written
as `<name>.part` beside a note of which are drawn, so an interrupted rendering goes on. A run that
sees few of them has only those drawn: a `.part` may stay one, with holes that take no disk. Those
that a run will look at are held against their checksums first, and drawn again where they differ.
"""

import functools
import multiprocessing
import os
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console

from jaxcam.config.sizes import rows_and_columns
from jaxcam.console.progress import progress
from jaxcam.data.caches import PICTURES_AT_ONCE, Cache, is_black
from jaxcam.data.cameras import require_possible
from jaxcam.data.demos import Demo, Demos
from jaxcam.data.header import Header
from jaxcam.data.samples import Layout
from jaxcam.errors import SimError
from jaxcam.files.locks import exclusive
from jaxcam.interrupts import serve_parent
from jaxcam.sim import make_painter, make_task, painter_of
from jaxcam.sim.lenses import SCALE
from jaxcam.sim.painter import Painter
from jaxcam.sim.types import View
from jaxcam.sim.world import World

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
    resolution: int | str,
    console: Console | None = None,
    wanted: np.ndarray | None = None,
) -> Pictures:
    """Renders what is missing of a dataset's pictures and opens them.

    Args:
        demos: The dataset; training demonstrations come first, validation ones after.
        resolution: Size of the pictures, see `jaxcam.config.sizes`.
        console: For progress; silent when None.
        wanted: Those that will be looked at, bool [pictures]; the others may stay empty. All when
            None.

    Raises:
        CameraError: If the cameras cannot have seen the demonstrations.
        DatasetError: If the disk has no room for them, or they are damaged.
        SimError: If pictures come out black.
    """
    require_possible(demos)
    look = painter_of(_scene(demos.header)).look()
    look += "" if demos.header.distortion is None else f"-lens{SCALE}x"
    name = f"{demos.path.stem}-{demos.fingerprint}-{resolution}px-{look}.npy"
    path = demos.path.parent / "frames" / name
    cache = cache_of(path, demos, resolution)
    if cache.complete:
        cache.adopt()
        if not cache.damaged(wanted).any():
            return _pictures(cache, demos)
    with exclusive(path, console):
        cache = cache_of(path, demos, resolution)
        cache.adopt()
        _render(cache, demos, resolution, console, wanted)
        return _pictures(cache, demos)


def cache_of(path: Path, demos: Demos, resolution: int | str) -> Cache:
    """Opens the cache that is complete at `path`, or is becoming so.

    Args:
        path: Of the complete cache.
        demos: The dataset whose pictures it holds.
        resolution: Size of the pictures.

    Raises:
        DatasetError: If it is not what was written.
    """
    return Cache(path, (Layout.of(demos).total, *rows_and_columns(resolution), 3))


def _pictures(cache: Cache, demos: Demos) -> Pictures:
    assert cache.rgb is not None
    return Pictures(cache.rgb, Layout.of(demos), cache.drawn)


def _render(
    cache: Cache,
    demos: Demos,
    resolution: int | str,
    console: Console | None,
    wanted: np.ndarray | None,
) -> None:
    """Draws the wanted pictures that are missing or damaged."""
    layout = Layout.of(demos)
    wanted = np.ones(layout.total, bool) if wanted is None else wanted
    missing = cache.begin(cache.damaged(wanted), wanted)
    if len(missing):
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
        drawn = draw_views(demos.header, resolution, map(view, groups), len(groups))
        job = f"rendering {demos.header.task} {resolution}"
        with progress(console, "rendering", total, done=total - len(missing), job=job) as advance:
            for rows, pictures in zip(groups, drawn, strict=True):
                cache.write(rows, pictures)
                advance(len(rows))
    cache.finish()


def draw_views(
    header: Header, resolution: int | str, views: Iterable[View], count: int
) -> Iterator[np.ndarray]:
    """Pictures of each view in order; by one process a core where one draws with one thread.

    Args:
        header: Of the dataset.
        resolution: Size of the pictures.
        views: What is drawn, a group of pictures each.
        count: Groups there are.

    Yields:
        Each group's pictures, uint8 [pictures, H, W, 3], top row first.
    """
    workers = min(os.cpu_count() or 1, count // GROUPS_PER_WORKER)
    if workers < 2 or painter_of(_scene(header)).uses_all_cores():
        draw = functools.partial(_draw_view, header.task, header.scene, resolution)
        yield from map(draw, views)
        return
    # Not forked: JAX has threads. The pool asks for the main module's file when it spawns.
    with ProcessPoolExecutor(
        workers,
        multiprocessing.get_context("spawn"),
        initializer=serve_parent,
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
def _renderer(task_name: str, scene_name: str, resolution: int | str, lenses: bool) -> Painter:
    task, size = make_task(task_name), rows_and_columns(resolution)
    return make_painter(task.scene(scene_name), *size, varied=task.varied, lenses=lenses)


def _draw_view(task: str, scene: str, resolution: int | str, view: View) -> np.ndarray:
    """Pictures of a view; if some are black, by another renderer, once."""
    for _ in range(2):
        pictures = _renderer(task, scene, resolution, view.lens is not None).rgb(view)
        black = sum(map(is_black, pictures))
        if not black:
            return pictures
        _renderer.cache_clear()
    raise SimError(
        f"{black} of {len(pictures)} pictures of a demonstration of {task}, {scene} are black, and "
        "again with another renderer. Free the graphics card's memory, or look where the cameras "
        "are: python -m jaxcam.check DATASET. What was drawn is kept."
    )


def _scene(header: Header) -> World:
    return make_task(header.task).scene(header.scene)


def views_of(
    demo: Demo, demos: Demos, resolution: int | str, which: np.ndarray | None = None
) -> View:
    """What a demonstration's pictures show, by time, then camera; of all, or of those named."""
    cameras = len(demo.cameras)
    which = np.arange(demo.length * cameras) if which is None else which
    t, camera = np.divmod(which, cameras)
    count = len(which)
    seen_by = demos.header.camera(demo.cameras[camera], *rows_and_columns(resolution))
    return View(
        qpos=demo.qpos[t],
        geom_size=np.broadcast_to(demo.geom_size, (count, *demo.geom_size.shape)),
        fixtures=np.broadcast_to(demo.fixtures, (count, *demo.fixtures.shape)),
        K=seen_by.K,
        world_from_camera=seen_by.world_from_camera,
        lens=seen_by.distortion,
    )
