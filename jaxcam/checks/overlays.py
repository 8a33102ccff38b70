"""Axes drawn over pictures: where grip and table are by the cameras' own numbers.

If the axes do not sit on the fingers and the table, pose, field of view, unit or picture is wrong.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import jax
import numpy as np

from jaxcam.data.demos import Demo, Demos
from jaxcam.data.pictures import views_of
from jaxcam.rays import Camera
from jaxcam.rays.rotations import matrix_from_quaternion
from jaxcam.sim.painter import Painter
from jaxcam.sim.world import World

PIXELS = 320
"""Side of a picture."""
COLUMNS = 4
"""Pictures side by side."""
NEAR = 0.02
"""Depth (m) below which nothing is drawn."""
AXES = ((213, 68, 44), (46, 158, 78), (36, 99, 214))
"""Colours of x, y and z."""
PATH = (240, 196, 25)
"""Colour of the way of the grip."""
GRIP_LENGTH, TABLE_LENGTH = 0.1, 0.2
"""Lengths (m) of the axes."""
_BACKGROUND, _INK, _BAR, _GAP = (24, 26, 30), (232, 234, 237), 24, 4


class Moment(NamedTuple):
    """One picture of a dataset."""

    row: int
    """Number of the demonstration in the file."""
    t: int
    """Control step."""
    camera: int
    """Within the demonstration's window."""


def moments(demos: Demos, count: int) -> list[Moment]:
    """Pictures of `count` demonstrations, each at another time and from another camera."""
    episodes = demos.episodes
    rows = chosen(len(episodes), count)
    return [
        Moment(row, episodes[row].length * i // len(rows), i % len(episodes[row].cameras))
        for i, row in enumerate(rows.tolist())
    ]


def chosen(total: int, count: int) -> np.ndarray:
    """`count` numbers below `total`, evenly spread, the first and the last among them."""
    return np.unique(np.linspace(0, total - 1, min(count, total)).astype(int))


def draw(demos: Demos, shown: Sequence[Moment], painter: Painter) -> np.ndarray:
    """Pictures drawn anew, uint8 [N, H, W, 3]."""
    episodes, parts = demos.episodes, []
    for row, t, camera in shown:
        number = np.array([t * len(episodes[row].cameras) + camera])
        parts.append(views_of(episodes[row], demos, painter.height, number))
    return painter.rgb(jax.tree.map(lambda *x: np.concatenate(x), *parts))


def draw_over(picture: np.ndarray, demos: Demos, shown: Moment, scene: World) -> None:
    """Draws what should be seen over a square picture, in place.

    That is the axes of grip and table, and the way of the grip.
    """
    demo, side = demos.episodes[shown.row], len(picture)
    eye = demos.header.camera(demo.cameras[shown.camera], side)
    draw_line(picture, eye, demo.eef_pos, PATH, 1)
    draw_axes(picture, eye, table_pose(demo, scene), TABLE_LENGTH)
    draw_axes(picture, eye, grip_pose(demo, shown.t), GRIP_LENGTH)


def grip_pose(demo: Demo, t: int) -> np.ndarray:
    """World from grip site [4, 4] at a control step."""
    return demo.world_from_grip()[t]


def table_pose(demo: Demo, scene: World) -> np.ndarray:
    """World from the middle of the table's surface [4, 4]."""
    position, quaternion = demo.fixtures[0, :3].copy(), demo.fixtures[0, 3:]
    position[2] = scene.table_top
    return _rigid(matrix_from_quaternion(quaternion), position)


def draw_axes(picture: np.ndarray, camera: Camera, pose: np.ndarray, length: float) -> None:
    """Draws the three axes of a frame into a picture, in place: x red, y green, z blue."""
    for axis, colour in enumerate(AXES):
        ends = pose[:3, 3] + np.linspace(0, length, 9)[:, None] * pose[:3, axis]
        draw_line(picture, camera, ends, colour, 2)


def sheet(pictures: Sequence[np.ndarray], captions: Sequence[str]) -> np.ndarray:
    """Pictures of one size with a line below each, as one picture."""
    height, width = pictures[0].shape[:2]
    columns = min(COLUMNS, len(pictures))
    lines = -(-len(pictures) // columns)
    size = (lines * (height + _BAR + _GAP) + _GAP, columns * (width + _GAP) + _GAP, 3)
    whole = np.full(size, _BACKGROUND, np.uint8)
    for i, (picture, caption) in enumerate(zip(pictures, captions, strict=True)):
        top = _GAP + i // columns * (height + _BAR + _GAP)
        start = _GAP + i % columns * (width + _GAP)
        whole[top : top + height, start : start + width] = picture
        place = (start + 4, top + height + _BAR - 8)
        cv2.putText(whole, caption, place, cv2.FONT_HERSHEY_SIMPLEX, 0.42, _INK, 1, cv2.LINE_AA)
    return whole


def draw_line(
    picture: np.ndarray, camera: Camera, points: np.ndarray, colour: Sequence[int], width: int
) -> None:
    """Draws what of a line in the world lies before the camera."""
    pixels, depth = camera.project(points)
    # Drawn in sixteenths of a pixel, whose centre is half a pixel from its corner in OpenCV.
    places = np.round((pixels - 0.5) * 16)
    for a, b in zip(range(len(points) - 1), range(1, len(points)), strict=True):
        if min(depth[a], depth[b]) > NEAR and abs(places[[a, b]]).max() < 2**20:
            start, end = (tuple(map(int, places[k])) for k in (a, b))
            cv2.line(picture, start, end, colour, width, cv2.LINE_AA, 4)


def _rigid(rotation: np.ndarray, position: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return pose
