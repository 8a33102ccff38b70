"""The page that shows an exhibit: viser's client, and beside it a panel of pictures, time and rays.

All is inside the file, so that it opens without a server and without a network. What answers the
pointer is the JavaScript beside this file, which gives viser's client the messages that viser's
server would send.
"""

import base64
import html
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from jaxcam.errors import DatasetError
from jaxcam.files.whole import MARK
from jaxcam.rays import Camera
from jaxcam.rays.lens import normalised, sight_lines
from jaxcam.rays.rotations import quaternion_from_matrix
from jaxcam.viewer.exhibit import Exhibit, Viewpoint
from jaxcam.viewer.scene import DEPTH, POINT, RAY, node_name, page_of, shown_of

LARGEST = 20_000_000
"""Bytes of a page."""
LATTICE = 65
"""Points along each axis at which the page knows which way a lens looks."""
_PARTS = Path(__file__).with_name("page")


def render_page(
    exhibit: Exhibit, episodes: Mapping[int, str] | None = None, number: int = 0
) -> str:
    """A whole page, at most `LARGEST` bytes.

    Args:
        exhibit: What is to be seen.
        episodes: What else can be asked of who serves the page, by numbers; nothing of a file.
        number: The one that this is.

    Raises:
        DatasetError: It would be larger, with the least pictures.
    """
    client = page_of(exhibit)
    for thinning in (1, 2, 4, 8, 16):
        data = _data(exhibit, thinning)
        data["episodes"] = [{"number": n, "label": text} for n, text in (episodes or {}).items()]
        data["number"] = number
        page = _whole(client, exhibit.title, data)
        if len(page) <= LARGEST:  # all of it is ASCII but names
            return page
    raise DatasetError(
        f"{exhibit.title}: the page would have {len(page) / 1e6:.0f} MB, and "
        f"{LARGEST / 1e6:.0f} are the most. Choose a shorter episode."
    )


def _whole(client: str, title: str, data: Mapping[str, Any]) -> str:
    script = "\n".join(
        (_PARTS / name).read_text("utf-8") for name in ("rays.js", "client.js", "panel.js")
    )
    style, quiet = ((_PARTS / name).read_text("utf-8") for name in ("panel.css", "quiet.js"))
    # Names are others': no "</script>" may be among them.
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    client = client.replace("<title>Viser</title>", f"<title>{html.escape(title)}</title>", 1)
    head, body = client.rsplit("</head>", 1)
    top, _ = body.rsplit("</body>", 1)
    return (
        f"{head}<style>{style}</style><script>{quiet}</script></head>{top}"
        '<aside id="panel" aria-label="Pictures and rays"></aside>'
        f'<script type="application/json" id="exhibit">{text}</script>'
        f'<script type="module">{script}</script>\n<!-- {MARK} -->\n</body></html>\n'
    )


def _data(exhibit: Exhibit, thinning: int) -> dict[str, Any]:
    """What the page's script knows of an exhibit."""
    shown = shown_of(exhibit)
    moving = [
        _moving(node_name("bodies", i, body.name), body.base_from_body)
        for i, body in enumerate(exhibit.bodies)
        if body.base_from_body.ndim > 2
    ]
    moving += [
        _moving(node_name("cameras", i, view.name), np.asarray(view.camera.world_from_camera))
        for i, view in enumerate(shown)
        if np.ndim(view.camera.world_from_camera) > 2
    ]
    groups: dict[str, Any] = {}
    for view in exhibit.viewpoints:
        group = groups.setdefault(view.group, {"colour": view.colour, "count": 0})
        group["count"] += 1
    return {
        "title": exhibit.title,
        "subtitle": exhibit.subtitle,
        "notes": exhibit.notes,
        "rate": exhibit.rate,
        "length": exhibit.length,
        "depth": DEPTH,
        "ray": RAY,
        "point": POINT,
        "groups": groups,
        "moving": moving,
        "views": [
            _view(node_name("cameras", i, view.name), view, thinning)
            for i, view in enumerate(shown)
        ],
        "ways": [
            {
                "node": f"{node_name('ways', i, way.name)}/now",
                "points": _floats(way.points),
            }
            for i, way in enumerate(exhibit.ways)
        ],
        "outcomes": [
            {
                "name": outcomes.name,
                "places": _floats(outcomes.places),
                "labels": outcomes.labels,
                "numbers": outcomes.numbers,
            }
            for outcomes in exhibit.outcomes
        ],
    }


def _moving(name: str, poses: np.ndarray) -> dict[str, str]:
    return {
        "node": name,
        "positions": _floats(poses[:, :3, 3]),
        "rotations": _floats(quaternion_from_matrix(poses[:, :3, :3])),
    }


def _view(name: str, view: Viewpoint, thinning: int) -> dict[str, Any]:
    camera = view.camera
    return {
        "node": name,
        "name": view.name,
        "group": view.group,
        "colour": view.colour,
        "width": camera.width,
        "height": camera.height,
        "K": _floats(np.asarray(camera.K)),
        "pose": _floats(np.asarray(camera.world_from_camera)[..., :3, :]),
        "lens": _lens(camera),
        "steps": list(view.steps[::thinning]),
        "pictures": [_jpeg(picture) for picture in view.pictures[::thinning]],
    }


def _lens(camera: Camera) -> dict[str, Any] | None:
    """Which way a lens looks, at a lattice over normalised coordinates; None of a pinhole.

    Between its points the page interpolates.
    """
    if camera.distortion is None:
        return None
    K = np.asarray(camera.K, float)
    corners = np.meshgrid([0.0, camera.width], [0.0, camera.height])
    x, y = normalised(K.reshape(-1, 1, 1, 3, 3), corners[0], corners[1])
    low, high = (np.array([f(x), f(y)]) for f in (np.min, np.max))
    step = (high - low) / (LATTICE - 1)
    across, down = (low[i] + step[i] * np.arange(LATTICE) for i in (0, 1))
    grid = np.meshgrid(across, down)
    distortion = np.asarray(camera.distortion, float)
    x, y, z = (np.asarray(a) for a in sight_lines(grid[0], grid[1], distortion, camera.lens))
    with np.errstate(divide="ignore", invalid="ignore"):
        directions = np.where(z > 1e-3, np.stack([x, y]) / z, np.nan)
    return {
        "low": low.tolist(),
        "step": step.tolist(),
        "size": LATTICE,
        "directions": _floats(np.moveaxis(directions, 0, -1)),
    }


def _floats(array: np.ndarray) -> str:
    """Numbers as the page's script reads them: float32, in base64."""
    return base64.b64encode(np.ascontiguousarray(array, "<f4").tobytes()).decode()


def _jpeg(picture: np.ndarray) -> str:
    bgr = cv2.cvtColor(np.asarray(picture), cv2.COLOR_RGB2BGR)
    done, content = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 88])
    assert done
    return base64.b64encode(content.tobytes()).decode()
