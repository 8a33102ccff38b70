"""An exhibit as viser's scene, inside a page that loads nothing: needs the extra `viz`."""

import io
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout

import numpy as np

from jaxcam.errors import ConfigError
from jaxcam.rays import Camera
from jaxcam.rays.rotations import quaternion_from_matrix
from jaxcam.reports.style import RATE
from jaxcam.viewer.exhibit import Exhibit, Outcomes, Viewpoint

try:
    import trimesh
    import viser
except ImportError as error:
    raise ConfigError("This needs viser: pip install 'jaxcam[viz]'.") from error

DEPTH = 0.16
"""Distance (m) of a shown picture from its camera, and of the corners of the others' frusta."""
POINTED = (255, 0, 160)
RAY, POINT = "/pointer/ray", "/pointer/point"
"""What shows the pixel under the pointer."""


def node_name(kind: str, number: int, name: str) -> str:
    """A scene node's name, in which a slash would make another node."""
    return f"/{kind}/{number:03d} {name.replace('/', '∕')}"


def page_of(exhibit: Exhibit) -> str:
    """Viser's client with the scene at the exhibit's first moment, as HTML."""
    with _server() as server:
        scene = server.scene
        scene.set_up_direction("+z")
        # Without a GPU, shadows and a mirrored surrounding take longer than all the rest.
        scene.configure_default_lights(cast_shadow=False)
        scene.configure_environment_map(None)
        server.initial_camera.look_at, server.initial_camera.position = outlook(exhibit)
        for i, body in enumerate(exhibit.bodies):
            pose = body.base_from_body.reshape(-1, 4, 4)[0]
            scene.add_mesh_simple(
                node_name("bodies", i, body.name),
                body.vertices,
                body.faces,
                color=body.colour,
                opacity=body.opacity if body.opacity < 1 else None,
                flat_shading=False,
                wxyz=quaternion_from_matrix(pose[:3, :3]),
                position=pose[:3, 3],
            )
        scene.add_frame("/base", axes_length=0.15, axes_radius=0.004)
        if not exhibit.bodies:
            scene.add_grid("/ground", width=3, height=3, cell_size=0.1, section_size=0.5)
        shown = shown_of(exhibit)
        for i, view in enumerate(shown):
            _add_camera(scene, node_name("cameras", i, view.name), view)
        others = [view for view in exhibit.viewpoints if view.beside]
        for group in dict.fromkeys(v.group for v in others):
            _add_others(scene, group, [v for v in others if v.group == group])
        for i, way in enumerate(exhibit.ways):
            name = node_name("ways", i, way.name)
            if len(way.points) > 1:
                lines = np.stack([way.points[:-1], way.points[1:]], 1)
                scene.add_line_segments(name, lines, way.colour, thickness=0.004)
            scene.add_icosphere(f"{name}/now", 0.012, color=way.colour, position=way.points[0])
        for i, outcomes in enumerate(exhibit.outcomes):
            _add_outcomes(scene, node_name("outcomes", i, outcomes.name), outcomes)
        ray = np.zeros((1, 2, 3))
        scene.add_line_segments(RAY, ray, POINTED, thickness=0.005, visible=False)
        scene.add_icosphere(POINT, 0.012, color=POINTED, visible=False)
        return scene.as_html()


@contextmanager
def _server() -> Iterator[viser.ViserServer]:
    """A server for the time that a scene is made; nobody is told of it."""
    with redirect_stdout(io.StringIO()):  # where it would print its address
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        try:
            yield server
        finally:
            server.stop()


def outlook(exhibit: Exhibit) -> tuple[np.ndarray, np.ndarray]:
    """What is looked at first, and from where: all cameras that have a frustum are to be seen."""
    poses = [np.asarray(v.camera.world_from_camera, float) for v in shown_of(exhibit)]
    eyes = np.array([pose.reshape(-1, 4, 4)[0, :3, 3] for pose in poses]).reshape(-1, 3)
    work = np.mean([way.points.mean(0) for way in exhibit.ways] or [[0.4, 0, 0.1]], axis=0)
    centre = (2 * work + (eyes.mean(0) if len(eyes) else work)) / 3
    reach = max([0.7, *np.linalg.norm(eyes - centre, axis=1)])
    return centre, centre + reach * np.array([1.2, -1.1, 0.8])


def shown_of(exhibit: Exhibit) -> list[Viewpoint]:
    """The cameras that have a node of their own; others of a group are one."""
    return [view for view in exhibit.viewpoints if not view.beside]


def frustum(camera: Camera, depth: float) -> np.ndarray:
    """Corners [4, 3] of a picture at a depth, in camera axes, clockwise from the top left.

    Those of the pinhole: the picture is flat, also where a lens bends rays.
    """
    K = np.asarray(camera.K, float).reshape(-1, 3, 3)[0]
    w, h = camera.width, camera.height
    corners = np.array([[0, 0, 1], [w, 0, 1], [w, h, 1], [0, h, 1]], float)
    return depth * np.linalg.solve(K, corners.T).T


def _lines(camera: Camera) -> np.ndarray:
    """Edges of a frustum in camera axes [8, 2, 3]."""
    corners = frustum(camera, DEPTH)
    around = np.stack([corners, np.roll(corners, -1, 0)], 1)
    return np.concatenate([np.stack([np.zeros_like(corners), corners], 1), around])


def _add_camera(scene: viser.SceneApi, name: str, view: Viewpoint) -> None:
    camera = view.camera
    pose = np.asarray(camera.world_from_camera, float).reshape(-1, 4, 4)[0]
    scene.add_frame(
        name,
        show_axes=False,
        wxyz=quaternion_from_matrix(pose[:3, :3]),
        position=pose[:3, 3],
    )
    scene.add_line_segments(f"{name}/frustum", _lines(camera), view.colour, thickness=0.004)
    if len(view.pictures):
        corners = frustum(camera, DEPTH)
        size = corners[2] - corners[0]
        scene.add_image(
            f"{name}/picture",
            np.asarray(view.pictures[0]),
            render_width=abs(size[0]),
            render_height=abs(size[1]),
            format="jpeg",
            cast_shadow=False,
            receive_shadow=False,
            position=corners.mean(0),
        )


def _add_others(scene: viser.SceneApi, group: str, views: list[Viewpoint]) -> None:
    """Cameras without pictures, as one node."""
    lines = []
    for view in views:
        pose = np.asarray(view.camera.world_from_camera, float).reshape(-1, 4, 4)[0]
        lines.append(0.4 * _lines(view.camera) @ pose[:3, :3].T + pose[:3, 3])
    name = f"/cameras/all other {group.replace('/', '∕')}"
    scene.add_line_segments(name, np.concatenate(lines), views[0].colour, thickness=0.0025)


def _add_outcomes(scene: viser.SceneApi, name: str, outcomes: Outcomes) -> None:
    """The sphere of cameras, coloured by success, and a ball for each camera."""
    scene.add_point_cloud(  # seen through, unlike a surface
        f"{name}/sphere",
        outcomes.shell[::2, ::2].reshape(-1, 3),
        (255 * np.asarray(RATE(outcomes.smooth[::2, ::2].ravel()))[:, :3]).astype(np.uint8),
        point_size=0.012,
        point_shape="circle",
        precision="float32",
    )
    ball = trimesh.creation.icosphere(2, 0.018)
    scene.add_batched_meshes_simple(
        f"{name}/cameras",
        np.asarray(ball.vertices, np.float32),
        np.asarray(ball.faces, np.uint32),
        batched_wxyzs=np.tile(np.array([1.0, 0, 0, 0], np.float32), (len(outcomes.places), 1)),
        batched_positions=outcomes.places.astype(np.float32),
        batched_colors=(255 * np.asarray(RATE(outcomes.rates))[:, :3]).astype(np.uint8),
    )
