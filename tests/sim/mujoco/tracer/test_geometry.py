"""What is drawn of a model is where MuJoCo has it, and surfaces as its materials say."""

import mujoco
import numpy as np
import pytest

from jaxcam.sim import make_task
from jaxcam.sim.mujoco.tracer.geometry import MESH, drawable, solids_of, surfaces_of

LIGHT = "<light type='directional' dir='0 0 -1' diffuse='.5 .5 .5' specular='.2 .2 .2'/>"


def model_of(geoms, assets="", lights=LIGHT):
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><asset>{assets}</asset><worldbody>{lights}{geoms}</worldbody></mujoco>"
    )


def test_triangles_of_rigid_meshes_are_where_their_geoms_are(scene):
    model = scene.visual
    solids, normals = solids_of(model)
    meshes = solids.geom[solids.kind == MESH]
    assert len(meshes) < (model.geom_type == MESH).sum() / 4
    assert len(solids.triangles) == model.mesh_facenum[model.geom_dataid].sum(
        where=model.geom_type == MESH
    )
    data = mujoco.MjData(model)
    data.qpos[:] = scene.qpos0 + np.random.default_rng(0).uniform(-0.3, 0.3, model.nq)
    mujoco.mj_kinematics(model, data)
    first = 0
    for frame in meshes:  # leaves of a tree lie together, in the order of the solids
        last = first
        while last < len(solids.part) and _welded(model, solids.part[last], frame):
            last += 1
        for geom in set(solids.part[first:last]):
            ours = solids.triangles[first:last][solids.part[first:last] == geom, :3]
            ours = ours @ data.geom_xmat[frame].reshape(3, 3).T + data.geom_xpos[frame]
            mesh = model.geom_dataid[geom]
            begin, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
            corner = model.mesh_face[begin : begin + count, 0] + model.mesh_vertadr[mesh]
            theirs = model.mesh_vert[corner] @ data.geom_xmat[geom].reshape(3, 3).T
            theirs = theirs + data.geom_xpos[geom]
            order = [np.lexsort(points.round(5).T) for points in (ours, theirs)]
            assert len(ours) == count
            np.testing.assert_allclose(ours.mean(0), theirs.mean(0), atol=1e-5)
            extremes = [
                points[rows][[0, -1]] for points, rows in zip((ours, theirs), order, strict=True)
            ]
            np.testing.assert_allclose(*extremes, atol=1e-3)
        first = last
    assert first == len(solids.part)
    lengths = np.linalg.norm(normals.reshape(-1, 3), axis=-1)
    np.testing.assert_allclose(lengths[lengths > 0], 1, atol=1e-3)
    assert (lengths == 0).mean() < 1e-3  # of triangles without an area


def _welded(model, one, other):
    bodies = model.geom_bodyid[[one, other]]
    return len(set(model.body_weldid[bodies])) == 1


def test_colours_are_the_geoms_own_or_their_materials():
    model = model_of(
        "<geom type='box' size='1 1 1' material='m'/>"
        "<geom type='box' size='1 1 1' material='m' rgba='0 1 0 1'/>"
        "<geom type='box' size='1 1 1' rgba='1 0 0 0'/>",
        "<material name='m' rgba='.1 .2 .3 1' specular='.4' shininess='.25' emission='.5'/>",
    )
    solids, normals = solids_of(model)
    assert list(solids.geom) == [0, 1]  # the third is not to be seen
    surfaces = surfaces_of(model, normals)
    np.testing.assert_allclose(surfaces.colour[:2], [[0.1, 0.2, 0.3], [0, 1, 0]])
    np.testing.assert_allclose(surfaces.specular[:2], 0.4)
    np.testing.assert_allclose(surfaces.exponent[:2], 32)
    head = model.vis.headlight
    expected = surfaces.colour[0] * (np.array(head.ambient) + 0.5)
    np.testing.assert_allclose(surfaces.ambient[0], expected, rtol=1e-6)
    strongest = 0.4 * max(0.2, *head.specular)
    assert strongest * surfaces.dull[0] ** 32 * 255 < 0.01


@pytest.mark.parametrize(
    ("geoms", "lights"),
    [
        ("<geom type='sphere' size='1'/>", LIGHT),
        ("<geom type='capsule' size='1 1'/>", LIGHT),
        ("<geom type='box' size='1 1 1' material='t'/>", LIGHT),
        ("<geom type='box' size='1 1 1'/>", "<light pos='0 0 3' type='spot'/>"),
    ],
)
def test_models_with_anything_else_are_refused(geoms, lights):
    assets = (
        "<texture name='t' type='2d' builtin='checker' width='8' height='8'/>"
        "<material name='t' texture='t'/>"
    )
    assert drawable(model_of("<geom type='plane' size='1 1 1' material='t'/>", assets))
    assert not drawable(model_of(geoms, assets, lights))


@pytest.mark.parametrize("name", ["lift", "pick_place_can", "square"])
def test_all_scenes_of_ours_are_drawn(name):
    assert all(drawable(make_task(name).scene(scene).visual) for scene in ("fixed", "randomized"))
