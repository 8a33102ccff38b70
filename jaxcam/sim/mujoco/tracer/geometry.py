"""What the ray tracer draws of a model: its solids, their triangles and how they look."""

from typing import NamedTuple

import mujoco
import numpy as np

from jaxcam.sim.mujoco.tracer.hierarchy import Trees, plant

PLANE, CYLINDER, BOX, MESH = (
    int(mujoco.mjtGeom.mjGEOM_PLANE),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER),
    int(mujoco.mjtGeom.mjGEOM_BOX),
    int(mujoco.mjtGeom.mjGEOM_MESH),
)
_SMOOTH = 0.8
"""Least cosine between a vertex's normal and its face's, for it to be used (`mjr_uploadMesh`)."""
_EXPONENT = 128.0
"""Exponent of a highlight at a material's shininess 1 (as in MuJoCo)."""
_UNSEEN = 2e-5
"""Share of full brightness that no 8-bit picture shows."""
_USUAL = np.float32(0.5)
"""Specular and shininess without a material, and the colour that stands for the material's."""


class Solids(NamedTuple):
    """Things with a pose of their own: geoms, and the meshes that are rigidly connected as one."""

    kind: np.ndarray
    """`PLANE`, `CYLINDER`, `BOX` or `MESH`, int32 [S]."""
    geom: np.ndarray
    """The geom whose pose and size they have, int32 [S]."""
    root: np.ndarray
    """Of a mesh's tree, int32 [S]."""
    lower: np.ndarray
    """Lower corner of a mesh's box, in the frame of that geom, float32 [S, 3]."""
    upper: np.ndarray
    """Its upper corner."""
    boxes: np.ndarray
    """See `Trees`."""
    children: np.ndarray
    """See `Trees`."""
    triangles: np.ndarray
    """First corner and the edges to the others, in the order of the leaves, float32 [T, 9]."""
    part: np.ndarray
    """The geom that each triangle is of, int32 [T]."""


class Surfaces(NamedTuple):
    """How geoms look in which lights."""

    normals: np.ndarray
    """Unit normals at the corners of triangles, in the frame of their solid, float32 [T, 9]."""
    colour: np.ndarray
    """float32 [geoms, 3]."""
    ambient: np.ndarray
    """What a geom sends without any light but the ambient one, float32 [geoms, 3]."""
    specular: np.ndarray
    """float32 [geoms]."""
    exponent: np.ndarray
    """Of the highlights, float32 [geoms]."""
    dull: np.ndarray
    """Cosine between normal and half-way direction below which a highlight adds nothing that an
    8-bit picture shows: less than `_UNSEEN` of full brightness, float32 [geoms]."""
    repeat: np.ndarray
    """How often the texture is repeated, along x and y; 0 without one, float32 [geoms, 2]."""
    texture: np.ndarray
    """The one texture there may be, float32 [h, w, 3]."""
    diffuse: np.ndarray
    """Of the lights, float32 [lights, 3]; the last is the one at the camera."""
    highlight: np.ndarray
    """Specular colours of the lights, float32 [lights, 3]."""
    shadowing: np.ndarray
    """Which lights cast shadows, bool [lights]."""


def drawable(model: mujoco.MjModel) -> bool:
    """Whether this ray tracer knows all that is to be seen of a model."""
    kinds = set(model.geom_type) <= {PLANE, CYLINDER, BOX, MESH}
    textured = [i for i in range(model.ngeom) if _texture(model, i) >= 0]
    planes = all(model.geom_type[i] == PLANE for i in textured)
    directional = (model.light_type == int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)).all()
    one = len({_texture(model, i) for i in textured}) <= 1
    return bool(kinds and planes and one and directional and model.light_active.all())


def solids_of(model: mujoco.MjModel) -> tuple[Solids, np.ndarray]:
    """A model's solids, and the corners' normals of their triangles, float32 [T, 9]."""
    rigid = _rigid_meshes(model)
    others = [i for i in range(model.ngeom) if model.geom_type[i] != MESH and _seen(model, i)]
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    corners, normals, part, counts = [], [], [], []
    for geoms in rigid:
        pieces = [_triangles(model, data, geom, geoms[0]) for geom in geoms]
        corners += [piece[0] for piece in pieces]
        normals += [piece[1] for piece in pieces]
        sizes = [len(piece[0]) for piece in pieces]
        part.append(np.repeat(geoms, sizes))
        counts.append(sum(sizes))
    points = np.concatenate(corners or [np.empty((0, 3, 3))]).astype(np.float32)
    trees: Trees = plant(points, np.array(counts, int))
    a, b, c = points[trees.order].transpose(1, 0, 2)
    meshes, rest = len(rigid), len(others)
    nowhere = np.zeros((rest, 3), np.float32)
    solids = Solids(
        kind=np.array([MESH] * meshes + [model.geom_type[i] for i in others], np.int32),
        geom=np.array([geoms[0] for geoms in rigid] + others, np.int32),
        root=np.concatenate([trees.roots, np.zeros(rest)]).astype(np.int32),
        lower=np.concatenate([trees.boxes[trees.roots, 0, 0], nowhere]),
        upper=np.concatenate([trees.boxes[trees.roots, 0, 1], nowhere]),
        boxes=trees.boxes,
        children=trees.children,
        triangles=np.concatenate([a, b - a, c - a], 1),
        part=np.concatenate([*part, np.empty(0)]).astype(np.int32)[trees.order],
    )
    smooth = np.concatenate(normals or [np.empty((0, 9))]).astype(np.float32)
    return solids, smooth[trees.order]


def surfaces_of(model: mujoco.MjModel, normals: np.ndarray) -> Surfaces:
    """How a model's geoms look, in the light of its lights.

    Args:
        model: The model.
        normals: At the corners of its triangles, see `solids_of`.
    """
    count, head = model.ngeom, model.vis.headlight
    active = np.asarray(head.active, float)
    colour = np.empty((count, 3))
    specular, shine = np.full(count, _USUAL), np.full(count, _USUAL)
    emission, repeat = np.zeros(count), np.zeros((count, 2))
    for i in range(count):
        colour[i], material = model.geom_rgba[i, :3], model.geom_matid[i]
        if material < 0:
            continue
        if (model.geom_rgba[i] == (_USUAL, _USUAL, _USUAL, 1)).all():
            colour[i] = model.mat_rgba[material, :3]
        specular[i], shine[i] = model.mat_specular[material], model.mat_shininess[material]
        emission[i] = model.mat_emission[material]
        if _texture(model, i) >= 0:
            repeat[i] = model.mat_texrepeat[material]
            if model.mat_texuniform[material]:
                repeat[i] *= np.where(model.geom_size[i, :2] > 0, model.geom_size[i, :2], 1)
    strength = specular * max(model.light_specular.max(initial=0), active * head.specular.max())
    exponent, glossy = shine * _EXPONENT, (strength > _UNSEEN) & (shine > 0)
    dull = np.full(count, 2.0)
    dull[glossy] = (_UNSEEN / strength[glossy]) ** (1 / exponent[glossy])
    textures = {_texture(model, i) for i in range(count)} - {-1}
    texture = _pixels(model, textures.pop()) if textures else np.ones((1, 1, 3))
    ambient = model.light_ambient.sum(0) + active * head.ambient
    return Surfaces(*map(np.ascontiguousarray, (
        normals,
        np.float32(colour),
        np.float32(colour * (ambient + emission[:, None])),
        np.float32(specular),
        np.float32(exponent),
        np.float32(dull),
        np.float32(repeat),
        np.float32(texture),
        np.float32(np.vstack([model.light_diffuse, active * head.diffuse])),
        np.float32(np.vstack([model.light_specular, active * head.specular])),
        np.array([*model.light_castshadow, False], bool),
    )))  # fmt: skip


def _seen(model: mujoco.MjModel, geom: int) -> bool:
    material = model.geom_matid[geom]
    usual = (model.geom_rgba[geom] == (_USUAL, _USUAL, _USUAL, 1)).all()
    alpha = model.mat_rgba[material, 3] if usual and material >= 0 else model.geom_rgba[geom, 3]
    return alpha > 0


def _texture(model: mujoco.MjModel, geom: int) -> int:
    """Number of a geom's texture; -1 without one."""
    material = model.geom_matid[geom]
    if material < 0:
        return -1
    return int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB])


def _pixels(model: mujoco.MjModel, texture: int) -> np.ndarray:
    shape = tuple(int(x[texture]) for x in (model.tex_height, model.tex_width, model.tex_nchannel))
    first = int(model.tex_adr[texture])
    pixels = np.asarray(model.tex_data[first : first + int(np.prod(shape))])
    return pixels.reshape(shape)[..., :3] / 255


def _rigid_meshes(model: mujoco.MjModel) -> list[list[int]]:
    """Numbers of the mesh geoms to be seen, those together that never move against each other."""
    groups: dict[tuple[int, int], list[int]] = {}
    for geom in range(model.ngeom):
        if model.geom_type[geom] == MESH and _seen(model, geom):
            body = model.geom_bodyid[geom]
            placed = int(model.body_mocapid[model.body_rootid[body]])  # by arrays, not by joints
            groups.setdefault((int(model.body_weldid[body]), placed), []).append(geom)
    return list(groups.values())


def _triangles(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, frame: int
) -> tuple[np.ndarray, np.ndarray]:
    """Corners [T, 3, 3] of a mesh geom and the normals there [T, 9], in another geom's frame."""
    mesh = int(model.geom_dataid[geom])
    first = model.mesh_faceadr[mesh]
    faces = slice(first, first + model.mesh_facenum[mesh])
    vertices = np.asarray(model.mesh_vert[model.mesh_vertadr[mesh] :], float)
    normals = np.asarray(model.mesh_normal[model.mesh_normaladr[mesh] :], float)
    corners = vertices[model.mesh_face[faces]]
    smooth = normals[model.mesh_facenormal[faces]]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.maximum(np.linalg.norm(flat, axis=-1, keepdims=True), 1e-30)
    sharp = (smooth * flat[:, None]).sum(-1) < _SMOOTH
    smooth = np.where(sharp[..., None], flat[:, None], smooth)
    there, here = (data.geom_xmat[i].reshape(3, 3) for i in (frame, geom))
    turn = there.T @ here
    offset = there.T @ (data.geom_xpos[geom] - data.geom_xpos[frame])
    return corners @ turn.T + offset, (smooth @ turn.T).reshape(-1, 9)
