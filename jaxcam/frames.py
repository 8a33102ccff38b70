"""The pictures of a dataset, rendered once per (dataset, cameras, resolution, renderer).

A cache is one uint8 array on disk, `[frames, H, W, 3]`, read through a memory map. It is written
as `<name>.part` beside a count of finished demonstrations, so an interrupted rendering goes on.
"""

import functools
import json
import multiprocessing
import os
import shutil
import signal
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console

from jaxcam.check_cameras import require_possible
from jaxcam.demos import Demo, Demos, Header
from jaxcam.errors import DatasetError, SimError
from jaxcam.locks import exclusive
from jaxcam.progress import progress
from jaxcam.rays import Camera
from jaxcam.rundir import write_atomically
from jaxcam.sim import make_task
from jaxcam.sim.world import Painter, View, World

DEMOS_PER_WORKER = 8
"""Demonstrations below which another process is not worth its start."""


@dataclass(frozen=True)
class Frames:
    """Pictures of some demonstrations: frame t of camera c of demo i is `pictures[at(i, t, c)]`."""

    pictures: np.ndarray = field(repr=False)
    """uint8 [frames, H, W, 3]."""
    first: np.ndarray = field(repr=False)
    """First frame of each demonstration [demos]."""
    cameras: np.ndarray = field(repr=False)
    """Number of cameras of each demonstration [demos]."""

    def at(self, demo: np.ndarray, t: np.ndarray, camera: np.ndarray) -> np.ndarray:
        """Index of a frame; `camera` counts within the demonstration's window."""
        return self.first[demo] + t * self.cameras[demo] + camera


def intrinsics(fovy_deg: float, resolution: int) -> np.ndarray:
    """K [3, 3] of a square picture with a vertical field of view in degrees."""
    camera = Camera.from_fovy(np.deg2rad(fovy_deg), resolution, resolution, np.eye(4))
    return np.asarray(camera.K)


def load_frames(demos: Demos, resolution: int, console: Console | None = None) -> Frames:
    """Renders what is missing of a dataset's pictures and opens them.

    Args:
        demos: the dataset; training demonstrations come first, validation ones after.
        resolution: side of the pictures (pixels).
        console: for progress; silent when None.

    Raises:
        CameraError: if the cameras cannot have seen the demonstrations.
        DatasetError: if the disk has no room for them, or they are damaged.
        SimError: if pictures come out blank.
    """
    require_possible(demos)
    name = f"{demos.path.stem}-{demos.fingerprint}-{resolution}px-{_scene(demos.header).look}.npy"
    path = demos.path.parent / "frames" / name
    if not path.exists():
        with exclusive(path, console):
            if not path.exists():
                _render(path, demos, resolution, console)
    return open_frames(path, demos, resolution)


def open_frames(path: Path, demos: Demos, resolution: int) -> Frames:
    """Opens a cache.

    Args:
        path: of the cache.
        demos: the dataset whose pictures it holds.
        resolution: side of the pictures (pixels).

    Raises:
        DatasetError: if it is not what was written.
    """
    first, counts = _places(demos)
    shape = (int(counts.sum()), resolution, resolution, 3)
    try:
        pictures = np.load(path, mmap_mode="r")
        found = f"{pictures.dtype} {list(pictures.shape)}"
    except (OSError, ValueError, EOFError) as error:
        pictures, found = None, f"{path.stat().st_size} bytes that cannot be read ({error})"
    if pictures is None or pictures.shape != shape or pictures.dtype != np.uint8:
        raise DatasetError(
            f"{path}: the pictures should be uint8 {list(shape)}, but are {found}. Delete the "
            "file; they are drawn anew."
        )
    windows = np.array([len(d.cameras) for d in demos.train + demos.valid])
    return Frames(pictures, first, windows)


def _places(demos: Demos) -> tuple[np.ndarray, np.ndarray]:
    """First frame and number of frames of each demonstration."""
    counts = np.array([d.length * len(d.cameras) for d in demos.train + demos.valid])
    return np.concatenate([[0], np.cumsum(counts)[:-1]]), counts


def _render(path: Path, demos: Demos, resolution: int, console: Console | None) -> None:
    first, counts = _places(demos)
    frames = int(counts.sum())
    _check_room(path, frames * resolution * resolution * 3)
    part = _Part(path, (frames, resolution, resolution, 3))
    rest = (demos.train + demos.valid)[part.done :]
    wanted = [views_of(demo, demos, resolution) for demo in rest]
    with progress(console, "rendering", frames, done=int(counts[: part.done].sum())) as advance:
        for i, pictures in enumerate(_draw(demos.header, resolution, wanted), part.done):
            part.write(int(first[i]), pictures, i + 1)
            advance(len(pictures))
    part.finish()


def _draw(header: Header, resolution: int, views: list[View]) -> Iterator[np.ndarray]:
    """Pictures of each view in order; by one process a core where one draws with one thread."""
    workers = min(os.cpu_count() or 1, len(views) // DEMOS_PER_WORKER)
    if workers < 2 or _scene(header).painter_uses_all_cores:
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
    return task.scene(scene_name).painter(resolution, varied=task.varied)


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


def _check_room(path: Path, size: int) -> None:
    part = path.with_suffix(".part")
    # Blocks, not length: an unfinished file is sparse.
    there = part.stat().st_blocks * 512 if part.exists() else 0
    free = shutil.disk_usage(path.parent).free
    if free + there < size * 1.05:
        raise DatasetError(
            f"{path.parent}: the pictures need {size / 1e9:.2g} GB, but {free / 1e9:.2g} GB "
            "are free. Choose another --data-dir or a smaller --resolution."
        )


def views_of(demo: Demo, demos: Demos, resolution: int) -> View:
    """Every frame of a demonstration in the cache's order: time, then camera."""
    cameras, length = len(demo.cameras), demo.length
    qpos = demo.qpos(demos.header.nq)[:length].repeat(cameras, 0)
    count = length * cameras
    K = intrinsics(demos.header.fovy_deg, resolution)
    return View(
        qpos=qpos,
        geom_size=np.broadcast_to(demo.geom_size, (count, *demo.geom_size.shape)),
        fixtures=np.broadcast_to(demo.fixtures, (count, *demo.fixtures.shape)),
        K=np.broadcast_to(K, (count, 3, 3)),
        world_from_camera=np.tile(demos.header.world_from_camera[demo.cameras], (length, 1, 1)),
    )


class _Part:
    """An unfinished cache and the count of demonstrations in it."""

    def __init__(self, path: Path, shape: tuple[int, ...]) -> None:
        self.path = path
        self.part = path.with_suffix(".part")
        self._count = path.with_suffix(".part.json")
        self.done = 0
        if self.part.exists() and self._count.exists():
            self.done = int(json.loads(self._count.read_text())["demos"])
        mode = "r+" if self.done else "w+"
        array = np.lib.format.open_memmap(self.part, mode, np.uint8, shape)
        self._offset, self._frame = array.offset, int(np.prod(shape[1:]))

    def write(self, first: int, pictures: np.ndarray, done: int) -> None:
        # Not through the map: where the disk is full that kills the process, this raises.
        try:
            with open(self.part, "r+b") as file:
                file.seek(self._offset + first * self._frame)
                file.write(np.ascontiguousarray(pictures).data)
            write_atomically(self._count, json.dumps({"demos": done}))
        except OSError as error:
            raise DatasetError(
                f"{self.part}: {error.strerror}. What is rendered is kept; make room and repeat."
            ) from error

    def finish(self) -> None:
        os.replace(self.part, self.path)
        self._count.unlink(missing_ok=True)
