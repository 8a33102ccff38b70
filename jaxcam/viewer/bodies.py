"""What MuJoCo's worlds are seen as: their visual geoms as bodies, posed by stored states."""

from typing import Any

import mujoco
import numpy as np
import trimesh

from jaxcam.rays import invert
from jaxcam.sim.mujoco.scene import FIXTURES, Scene
from jaxcam.sim.types import Start
from jaxcam.viewer.exhibit import RGB, Body

COARSE = 0.005
"""Cells (m) whose vertices become one, at their mean: 167 thousand triangles become 64 thousand."""


def bodies_of(
    scene: Scene, varied: tuple[str, ...], qpos: np.ndarray, start: Start
) -> tuple[Body, ...]:
    """The robot and all objects, and the table; the room is left out.

    Args:
        scene: The world.
        varied: Geoms of the physics model whose size the start has.
        qpos: Joint positions [T, nq].
        start: Of the episode.
    """
    model, data = scene.visual, mujoco.MjData(scene.visual)
    data.mocap_pos[scene.fixtures] = start.fixtures[:, :3]
    data.mocap_quat[scene.fixtures] = start.fixtures[:, 3:]
    poses = np.tile(np.eye(4), (len(qpos), model.nbody, 1, 1))
    for pose, row in zip(poses, qpos, strict=True):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        pose[:, :3, :3], pose[:, :3, 3] = data.xmat.reshape(-1, 3, 3), data.xpos
    poses = np.asarray(invert(scene.world_from_base)) @ poses
    sizes = model.geom_size.copy()
    for name, size in zip(varied, start.geom_size, strict=True):
        sizes[model.geom(f"{name}_vis").id] = size
    room = model.body(FIXTURES[1]).id
    parts: dict[tuple[int, RGB], list[trimesh.Trimesh]] = {}
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        mesh = None if body == room else _mesh(model, geom, sizes[geom])
        if mesh is not None:
            parts.setdefault((body, _colour(model, geom)), []).append(mesh)
    return tuple(
        _body(model.body(body).name, colour, meshes, poses[:, body])
        for (body, colour), meshes in parts.items()
    )


def grip_places(scene: Scene, qpos: np.ndarray) -> np.ndarray:
    """Where the grip is in the world (m) [T, 3] at joint positions [T, nq]."""
    data = mujoco.MjData(scene.physics)
    places = np.empty((len(qpos), 3))
    for place, row in zip(places, qpos, strict=True):
        data.qpos[:] = row
        mujoco.mj_kinematics(scene.physics, data)
        place[:] = data.site_xpos[scene.grip_site]
    return places


def _body(name: str, colour: RGB, meshes: list[trimesh.Trimesh], poses: np.ndarray) -> Body:
    """Parts of one body and one colour as one; what stands has one pose."""
    whole: Any = trimesh.util.concatenate(meshes)
    stands = np.allclose(poses, poses[:1], atol=1e-6)
    return Body(
        name=f"{name} {bytes(colour).hex()}",
        vertices=np.asarray(whole.vertices, np.float32),
        faces=np.asarray(whole.faces, np.int32),
        colour=colour,
        base_from_body=poses[0] if stands else poses,
    )


def _mesh(model: mujoco.MjModel, geom: int, size: np.ndarray) -> trimesh.Trimesh | None:
    """The surface of a geom in its body's frame; None of endless ones."""
    kinds = mujoco.mjtGeom
    match model.geom_type[geom]:
        case kinds.mjGEOM_MESH:
            mesh = _coarse(*_stored(model, int(model.geom_dataid[geom])))
        case kinds.mjGEOM_BOX:
            mesh = trimesh.creation.box(2 * size)
        case kinds.mjGEOM_SPHERE:
            mesh = trimesh.creation.icosphere(3, size[0])
        case kinds.mjGEOM_ELLIPSOID:
            mesh = trimesh.creation.icosphere(3)
            mesh.apply_scale(size)
        case kinds.mjGEOM_CYLINDER:
            mesh = trimesh.creation.cylinder(size[0], 2 * size[1], sections=32)
        case kinds.mjGEOM_CAPSULE:
            mesh = trimesh.creation.capsule(2 * size[1], size[0], count=(16, 24))
        case _:
            return None
    body_from_geom = trimesh.transformations.quaternion_matrix(model.geom_quat[geom])
    body_from_geom[:3, 3] = model.geom_pos[geom]
    return mesh.apply_transform(body_from_geom)


def _stored(model: mujoco.MjModel, mesh: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a mesh of the model."""
    vertex, face = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
    vertices = model.mesh_vert[vertex : vertex + model.mesh_vertnum[mesh]]
    return vertices, model.mesh_face[face : face + model.mesh_facenum[mesh]]


def _coarse(vertices: np.ndarray, faces: np.ndarray) -> trimesh.Trimesh:
    """A mesh whose vertices within one cell are one, at their mean."""
    _, cell = np.unique(np.round(vertices / COARSE), axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    count = np.bincount(cell)[:, None]
    means = np.stack([np.bincount(cell, axis) for axis in vertices.T], 1) / count
    corners = np.sort(cell[faces], 1)
    flat = (corners[:, 0] == corners[:, 1]) | (corners[:, 1] == corners[:, 2])
    _, first = np.unique(corners, axis=0, return_index=True)
    kept = np.zeros(len(faces), bool)
    kept[first] = True
    return trimesh.Trimesh(means, cell[faces][kept & ~flat], process=False)


def _colour(model: mujoco.MjModel, geom: int) -> RGB:
    material = int(model.geom_matid[geom])
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    red, green, blue = (round(255 * float(level)) for level in rgba[:3])
    return red, green, blue
