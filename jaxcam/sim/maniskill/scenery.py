"""What is only seen in ManiSkill's environments: table, floor, light robots, and cameras.

Needs the extra `jaxcam[maniskill]`.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import sapien
import torch
from mani_skill.utils.scene_builder.table import scene_builder
from mani_skill.utils.structs import Pose

from jaxcam.rays import sapien_from_opencv
from jaxcam.rays.rotations import quaternion_from_matrix
from jaxcam.sim.maniskill.memory import FAR, NEAR
from jaxcam.sim.maniskill.meshes import Mesh, fewer

TABLE = (-0.12, 0.0, -0.9196429)
"""Where ManiSkill's table stands (m), turned by a quarter; its top is at height 0."""
TABLE_SCALE = 1.75
"""Of its mesh."""


class SeenTable:
    """A table to be seen and moved; what is touched is ManiSkill's, which is hidden.

    The floor is plain white from now on.

    Args:
        scene: ManiSkill's scene.
        table_scene: ManiSkill's table and floor in it.
        stretch: How much longer than ManiSkill's the table is.
    """

    def __init__(self, scene: Any, table_scene: Any, stretch: float) -> None:
        for table in table_scene.table._objs:
            _hide(table)
        for ground in table_scene.ground._objs:
            _whiten(ground)
        mesh = Path(scene_builder.__file__).parent / "assets" / "table.glb"
        builder = scene.create_actor_builder()
        builder.add_visual_from_file(
            str(mesh),
            scale=[TABLE_SCALE * stretch, TABLE_SCALE, TABLE_SCALE],
            pose=sapien.Pose(q=_yaw(np.pi / 2)),
        )
        builder.initial_pose = sapien.Pose(TABLE, _yaw(np.pi / 2))
        self._actor = builder.build_kinematic(name="seen_table")

    def place(self, tensor: Callable[[np.ndarray], torch.Tensor], fixture: np.ndarray) -> None:
        """Moves it.

        Args:
            tensor: Makes tensors on the environments' device.
            fixture: Shifts and turns (xyz, wxyz) of the tables [B, 7].
        """
        self._actor.set_pose(Pose.create(tensor(_table(fixture))))


def lighten(entity: sapien.Entity) -> None:
    """Takes away most triangles of what is drawn of an entity; what is touched stays.

    Args:
        entity: A link of a robot, or a floor, best before it is first drawn.
    """
    body = _drawn_part(entity)
    if body is None:
        return
    light = sapien.render.RenderBodyComponent()
    for drawn in (drawn for shape in body.render_shapes for drawn in _lighter(shape)):
        light.attach(drawn)
    light.name, light.visibility = body.name, body.visibility
    light.shading_mode = body.shading_mode
    if body.is_render_id_disabled:
        light.disable_render_id()
    if not body.is_enabled:
        light.disable()
    entity.remove_component(body)
    entity.add_component(light)


def set_camera(sensor: Any, K: np.ndarray, world_from_camera: np.ndarray) -> None:
    """Gives one of ManiSkill's cameras intrinsics and a pose, from the next picture on.

    Args:
        sensor: The camera.
        K: Pixels [3, 3].
        world_from_camera: OpenCV axes [4, 4].
    """
    camera = sensor.camera
    (fx, skew, cx), (_, fy, cy) = np.asarray(K, float)[:2].tolist()
    camera.set_perspective_parameters(NEAR, FAR, fx, fy, cx, cy, skew)
    camera.set_local_pose(sapien_pose(world_from_camera))
    # ManiSkill remembers what it thinks never changes.
    camera._cached_intrinsic_matrix = None
    camera._cached_extrinsic_matrix = camera._cached_model_matrix = None


def sapien_pose(world_from_camera: np.ndarray) -> Any:
    """SAPIEN's pose of a camera with OpenCV axes [4, 4]."""
    pose = np.asarray(sapien_from_opencv(world_from_camera), float)
    return sapien.Pose(pose[:3, 3].tolist(), quaternion_from_matrix(pose[:3, :3]).tolist())


def _table(fixture: np.ndarray) -> np.ndarray:
    """Poses [B, 7] of the table that is seen, for its shifts and turns [B, 7]."""
    yaw = 2 * np.arctan2(fixture[:, 6], fixture[:, 3]) + np.pi / 2
    poses = np.zeros((len(fixture), 7))
    poses[:, :3] = TABLE
    poses[:, :2] += fixture[:, :2]
    poses[:, 3], poses[:, 6] = np.cos(yaw / 2), np.sin(yaw / 2)
    return poses


def _yaw(angle: float) -> list[float]:
    return [float(np.cos(angle / 2)), 0.0, 0.0, float(np.sin(angle / 2))]


def _drawn_part(entity: sapien.Entity) -> Any:
    """What of an entity is rendered; None without a renderer."""
    return entity.find_component_by_type(sapien.render.RenderBodyComponent)


def _lighter(shape: Any) -> list[Any]:
    """Shapes that look like one and have fewer triangles; a box or a ball stays what it is."""
    if not isinstance(shape, sapien.render.RenderShapeTriangleMesh):
        return [shape.clone()]
    shapes, are_same = [], True
    for part in shape.parts:
        mesh = Mesh(part.vertices, part.triangles, part.get_vertex_normal(), part.get_vertex_uv())
        light = fewer(mesh, has_texture=_has_texture(part.material))
        are_same &= light is mesh
        drawn = sapien.render.RenderShapeTriangleMesh(*light, part.material)
        drawn.local_pose, drawn.scale = shape.local_pose, shape.scale
        drawn.front_face, drawn.name = shape.front_face, shape.name
        shapes.append(drawn)
    return [shape.clone()] if are_same else shapes


def _has_texture(material: Any) -> bool:
    kinds = "base_color", "emission", "metallic", "normal", "roughness", "transmission"
    return any(getattr(material, f"{kind}_texture") is not None for kind in kinds)


def _hide(entity: sapien.Entity) -> None:
    body = _drawn_part(entity)
    if body is not None:
        body.visibility = 0.0


def _whiten(entity: sapien.Entity) -> None:
    """Takes the pattern away, which would tell where the camera is."""
    body = _drawn_part(entity)
    for shape in [] if body is None else body.render_shapes:
        for part in shape.parts:
            part.material.set_base_color([1.0, 1.0, 1.0, 1.0])
            part.material.set_base_color_texture(None)
