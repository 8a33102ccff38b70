"""What is to be seen, whatever it is of: bodies, cameras with pictures, ways, outcomes.

Everything stands in the frame of the robot's base (m), so that what is of several sources can be
laid over each other. What has a first axis T moves with time; the rest stands.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jaxcam.rays import Camera

GREEN, RED = (46, 158, 78), (213, 68, 44)
"""Cameras of training and of the test, as in the paper's figure."""
FIRST, SECOND = (0, 114, 178), (230, 159, 0)
"""What is laid over each other."""

RGB = tuple[int, int, int]


@dataclass(frozen=True)
class Body:
    """A rigid thing."""

    name: str
    vertices: np.ndarray = field(repr=False)
    """Corners (m) in its own frame, float32 [N, 3]."""
    faces: np.ndarray = field(repr=False)
    """Triangles, numbers of corners [F, 3]."""
    colour: RGB
    base_from_body: np.ndarray = field(repr=False)
    """Poses [4, 4] or [T, 4, 4]."""
    opacity: float = 1.0


@dataclass(frozen=True)
class Viewpoint:
    """A camera, and what it saw."""

    name: str
    group: str
    """What it is for: "training" or "test", or whose it is where two are laid over each other."""
    colour: RGB
    camera: Camera = field(repr=False)
    """In the base frame; K and pose may have a first axis T. Its lens is packed, or none."""
    pictures: Sequence[np.ndarray] = field(default=(), repr=False)
    """What it saw at `steps`, uint8 [height, width, 3] of the camera's size."""
    steps: Sequence[int] = ()
    """When."""
    beside: bool = False
    """Whether it is one of many that are drawn small, without pictures."""
    known_as: tuple[str, ...] = ()
    """Its names where it has several, as a camera that stands still through several episodes."""


@dataclass(frozen=True)
class Way:
    """The way of a grip."""

    name: str
    colour: RGB
    points: np.ndarray = field(repr=False)
    """Where it was (m) [T, 3]."""


@dataclass(frozen=True)
class Outcomes:
    """What came of rollouts, by where their camera stood."""

    name: str
    places: np.ndarray = field(repr=False)
    """Of the cameras (m) [N, 3]."""
    rates: np.ndarray = field(repr=False)
    """Success rates of the rollouts from there [N]."""
    labels: tuple[str, ...] = field(repr=False)
    """Each in words."""
    numbers: tuple[int, ...] = field(repr=False)
    """Of the pairs [N]."""
    shell: np.ndarray = field(repr=False)
    """The sphere of cameras, as corners (m) [rows, columns, 3] of a net."""
    smooth: np.ndarray = field(repr=False)
    """Smoothed success rates at these [rows, columns]."""


@dataclass(frozen=True)
class Exhibit:
    """All that is to be seen of one episode."""

    title: str
    subtitle: str
    rate: float = 1.0
    """Steps a second."""
    bodies: tuple[Body, ...] = ()
    viewpoints: tuple[Viewpoint, ...] = ()
    ways: tuple[Way, ...] = ()
    outcomes: tuple[Outcomes, ...] = ()
    notes: tuple[str, ...] = ()
    """What one should know of it, a sentence each."""

    @property
    def length(self) -> int:
        """Moments of time that it has; 1 where nothing moves."""
        poses = [b.base_from_body for b in self.bodies]
        poses += [v.camera.world_from_camera for v in self.viewpoints]
        moving = [len(pose) for pose in poses if np.ndim(pose) > 2]
        shown = [v.steps[-1] + 1 for v in self.viewpoints if len(v.steps)]
        return max([1, *moving, *shown, *(len(way.points) for way in self.ways)])


def overlaid(first: Exhibit, second: Exhibit, names: tuple[str, str]) -> Exhibit:
    """Two exhibits at once; cameras and ways get the colour of whose they are.

    Bodies of the second are seen through. Where both have a camera of one name, a note says how far
    apart they are.

    Args:
        first: One of them.
        second: The other.
        names: What they are called.
    """
    one, other = (
        _named(exhibit, name, colour)
        for exhibit, name, colour in zip((first, second), names, (FIRST, SECOND), strict=True)
    )
    return Exhibit(
        title=f"{names[0]} and {names[1]}",
        subtitle="; ".join(dict.fromkeys([first.subtitle, second.subtitle])),
        rate=first.rate,
        bodies=(*one.bodies, *(replace(body, opacity=0.4) for body in other.bodies)),
        viewpoints=one.viewpoints + other.viewpoints,
        ways=one.ways + other.ways,
        outcomes=one.outcomes + other.outcomes,
        notes=(*cameras_apart(first, second), *one.notes, *other.notes),
    )


def cameras_apart(first: Exhibit, second: Exhibit) -> list[str]:
    """How far cameras of one name are apart in two exhibits, a sentence each."""
    others = {
        name: view
        for view in second.viewpoints
        if not view.beside
        for name in view.known_as or (view.name,)
    }
    compared: dict[tuple[int, int], str] = {}
    for view in first.viewpoints:
        for name in view.known_as or (view.name,):
            if name in others and (id(view), id(others[name])) not in compared:
                apart = _apart(view.camera, others[name].camera)
                compared[id(view), id(others[name])] = f"{name}: {apart} apart."
    return list(compared.values())


def _apart(first: Camera, second: Camera) -> str:
    """How far two cameras are apart, where they begin."""
    a, b = (
        np.asarray(camera.world_from_camera, float).reshape(-1, 4, 4)[0]
        for camera in (first, second)
    )
    cosine = (np.trace(a[:3, :3].T @ b[:3, :3]) - 1) / 2
    turned = np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))
    moved = 1000 * np.linalg.norm(a[:3, 3] - b[:3, 3])
    return f"{moved:.1f} mm and {turned:.2f} degrees"


def _named(exhibit: Exhibit, name: str, colour: RGB) -> Exhibit:
    """An exhibit whose parts say whose they are."""
    return replace(
        exhibit,
        bodies=tuple(replace(b, name=f"{name}: {b.name}") for b in exhibit.bodies),
        viewpoints=tuple(
            replace(v, name=f"{name}: {v.name}", group=name, colour=colour)
            for v in exhibit.viewpoints
        ),
        ways=tuple(replace(w, name=f"{name}: {w.name}", colour=colour) for w in exhibit.ways),
        outcomes=tuple(replace(o, name=f"{name}: {o.name}") for o in exhibit.outcomes),
        notes=tuple(f"{name}: {note}" for note in exhibit.notes),
    )
